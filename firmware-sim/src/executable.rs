//! What a linked program says about itself: sizes, symbols, and which source an instruction comes from.
//!
//! In:  an ELF file from `firmware.rs`, with line tables.
//! Out: sizes of sections and the part of the decoder that each address belongs to, for `benchmark.rs`.
//!
//! Why here: kernels in Rust are inlined, so their instructions are found by the line table; kernels in assembly have
//! no line table and are found by their symbols.

use addr2line::Context;
use addr2line::gimli::{self, Dwarf, EndianSlice, LittleEndian, SectionId};
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

use crate::error::{Error, Result};

/// Folder of the kernels, as the line table names it.
const KERNEL_FOLDER: &str = "core/src/kernel/";
/// First letters of every symbol in assembly.
const KERNEL_SYMBOL: &str = "karakuri_";
/// What is in the names of the compiler's own routines: wide products, software floats, copies of memory.
const LIBRARY_SYMBOLS: [&str; 3] = ["compiler_builtins", "__aeabi_", "libm"];

/// What an instruction is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Multiply-accumulate loops.
    Kernel,
    /// The compiler's routines for what the processor has no instruction for.
    Library,
    /// Everything else: requantisation, activation, loops around the kernels.
    Other,
}

/// An ELF file with its line table.
pub struct Executable<'a> {
    file: object::File<'a>,
    /// Address and name of every function, in order of addresses.
    functions: Vec<(u64, &'a str)>,
    lines: Context<EndianSlice<'a, LittleEndian>>,
}

impl<'a> Executable<'a> {
    /// Finds symbols and line tables.
    ///
    /// # Errors
    /// [`Error::Firmware`] if the bytes are no ELF file.
    pub fn parse(elf: &'a [u8]) -> Result<Self> {
        let file = object::File::parse(elf).map_err(unreadable)?;
        let lines = read_lines(&file).map_err(unreadable)?;
        let functions = read_functions(&file);
        Ok(Self { file, functions, lines })
    }

    /// Bytes of a section, 0 if there is none.
    pub fn section_bytes(&self, name: &str) -> u64 {
        self.file.section_by_name(name).map_or(0, |section| section.size())
    }

    /// Address of a symbol.
    ///
    /// # Errors
    /// [`Error::Firmware`] if there is no such symbol.
    pub fn symbol_address(&self, name: &str) -> Result<u64> {
        let symbol = self.file.symbols().find(|symbol| symbol.name() == Ok(name));
        let symbol = symbol.ok_or_else(|| unreadable(format!("no symbol {name}")))?;
        Ok(symbol.address())
    }

    /// What the instruction at an address is for.
    pub fn purpose(&self, address: u32) -> Purpose {
        if self.is_inlined_from(address, KERNEL_FOLDER) {
            return Purpose::Kernel;
        }
        // The symbol of a Thumb function is odd, so an even address would miss the function that begins there.
        match self.function_at(u64::from(address) | 1) {
            Some(symbol) if symbol.starts_with(KERNEL_SYMBOL) => Purpose::Kernel,
            Some(symbol) if LIBRARY_SYMBOLS.iter().any(|name| symbol.contains(name)) => {
                Purpose::Library
            }
            _ => Purpose::Other,
        }
    }

    /// The last function that begins at the address or before.
    fn function_at(&self, address: u64) -> Option<&str> {
        let after = self.functions.partition_point(|(start, _)| *start <= address);
        self.functions.get(after.checked_sub(1)?).map(|&(_, name)| name)
    }

    /// Whether any function that the instruction was inlined from stands in a file of the folder.
    fn is_inlined_from(&self, address: u32, folder: &str) -> bool {
        let frames = self.lines.find_frames(u64::from(address)).skip_all_loads();
        let Ok(mut frames) = frames else { return false };
        while let Ok(Some(frame)) = frames.next() {
            let file = frame.location.and_then(|location| location.file);
            if file.is_some_and(|file| file.contains(folder)) {
                return true;
            }
        }
        false
    }
}

fn read_functions<'a>(file: &object::File<'a>) -> Vec<(u64, &'a str)> {
    let symbols = file.symbols().filter(|symbol| symbol.kind() == SymbolKind::Text);
    let named = symbols.filter_map(|symbol| Some((symbol.address(), symbol.name().ok()?)));
    let mut functions: Vec<_> = named.collect();
    functions.sort_unstable();
    functions
}

fn read_lines<'a>(
    file: &object::File<'a>,
) -> gimli::Result<Context<EndianSlice<'a, LittleEndian>>> {
    let section = |id: SectionId| {
        let section = file.section_by_name(id.name());
        let bytes = section.and_then(|section| section.data().ok()).unwrap_or_default();
        gimli::Result::Ok(EndianSlice::new(bytes, LittleEndian))
    };
    Context::from_dwarf(Dwarf::load(section)?)
}

fn unreadable(reason: impl ToString) -> Error {
    Error::Firmware { reason: "not readable as a program".into(), log: reason.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_that_are_no_program_are_rejected() {
        let error = Executable::parse(b"program").err().unwrap().to_string();
        assert!(error.contains("not readable as a program"), "{error}");
    }
}
