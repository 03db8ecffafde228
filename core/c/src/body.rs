//! A body in memory that the caller owns.

use core::mem::MaybeUninit;

use karakuri::{BlobError, Decoder, Model, Player, ServoStage, Workspace};

use crate::Status;
use crate::servo::{CServo, maps};

/// Channels of the largest model.
const CHANNELS_MAX: usize = 32;

/// Widest layer of the largest model.
const WIDTH_MAX: usize = 256;

/// `KARAKURI_STORAGE_BYTES`.
pub const STORAGE_BYTES: usize = 13_312;

/// `karakuri_storage_t`.
#[derive(Debug)]
#[repr(C, align(8))]
pub struct Storage([MaybeUninit<u8>; STORAGE_BYTES]);

const _: () = assert!(size_of::<Body>() <= STORAGE_BYTES && align_of::<Body>() <= 8);

/// The caller's servos, or those of the blob where he gives none.
fn stage(servos: &[CServo], model: &Model<'_>) -> Result<ServoStage, Status> {
    if !servos.is_empty() {
        let maps = maps(servos).ok_or(Status::BadServo)?;
        return ServoStage::new(&maps).map_err(|_| Status::BadServo);
    }
    model.servos().next().ok_or(Status::BadServo)?;
    ServoStage::from_maps(model.servos()).map_err(|_| Status::BadServo)
}

/// A player of any model that fits.
type AnyPlayer = Player<'static, 'static, CHANNELS_MAX>;

/// A player and all that it borrows. Lives in a [`Storage`] and never moves.
#[derive(Debug)]
pub struct Body {
    /// Borrows the other two fields; nobody else touches them after it was made.
    player: MaybeUninit<AnyPlayer>,
    model: Model<'static>,
    workspace: Workspace<WIDTH_MAX>,
}

impl Body {
    /// Makes a body in a storage.
    ///
    /// # Safety
    /// `storage` is valid, aligned and nobody else's as long as the body is used.
    pub(crate) unsafe fn place(
        storage: *mut Storage,
        blob: &'static [u8],
        servos: &[CServo],
        seed: u64,
    ) -> Result<*mut Self, Status> {
        let body: *mut Self = storage.cast();
        // SAFETY: a storage is at least as large and as aligned as a body; each field is written before it is
        // borrowed. The references live as long as the body, because it does not move and nothing but the player,
        // which borrows them, uses these fields.
        let (model, workspace) = unsafe {
            (&raw mut (*body).model).write(Model::empty());
            (&raw mut (*body).workspace).write(Workspace::new());
            (&mut (*body).model, &mut (*body).workspace)
        };
        model.load(blob).map_err(|_| Status::BadBlob)?;
        let model: &'static Model<'static> = model;
        let stage = stage(servos, model)?;
        let decoder = Decoder::new(model, workspace).map_err(|error| match error {
            BlobError::WorkspaceTooSmall { .. } => Status::TooLarge,
            _ => Status::BadBlob,
        })?;
        let player = Player::new(model, decoder, 1, stage, seed)?;
        // SAFETY: as above.
        unsafe { (&raw mut (*body).player).write(MaybeUninit::new(player)) };
        Ok(body)
    }

    /// The player of a body; `None` for null.
    ///
    /// # Safety
    /// As [`place`](Self::place) gave it, not used by anyone else as long as the player is.
    pub(crate) unsafe fn player<'b>(body: *const Self) -> Option<&'b AnyPlayer> {
        if body.is_null() {
            return None;
        }
        // SAFETY: not null, and `place`, the only maker of bodies, has written the player. Only this field is
        // borrowed: the others are the player's.
        Some(unsafe { (*body).player.assume_init_ref() })
    }

    /// The same, to be told something.
    ///
    /// # Safety
    /// As above.
    pub(crate) unsafe fn player_mut<'b>(body: *mut Self) -> Option<&'b mut AnyPlayer> {
        if body.is_null() {
            return None;
        }
        // SAFETY: as above.
        Some(unsafe { (*body).player.assume_init_mut() })
    }
}
