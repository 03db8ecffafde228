//! karakuri for C and C++: a player in memory that the caller owns.
//!
//! In:  calls of `include/karakuri.h`.
//! Out: pulses.
//!
//! Why here: C cannot name the types of the crate. This is the one place beside the kernels with `unsafe`: pointers
//! come from C. What a caller must promise stands in the header; what can be checked is.
//!
//! # Safety
//! Every function takes `body` as [`karakuri_init`] gave it, not used by anyone else during the call, or null, which
//! does nothing. That is all the `SAFETY` comments rely on, where they do not say more.

#![cfg_attr(target_os = "none", no_std)]
#![allow(unsafe_code)]

mod body;
mod servo;

use core::ffi::{CStr, c_char};

use karakuri::{ActionId, Dials, Fault, Intent, PlayError, Player, PlayerState, SampleError};

pub use body::{Body, STORAGE_BYTES, Storage};
pub use servo::CServo;

/// `karakuri_status_t`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
#[allow(missing_docs, reason = "the header says it")]
pub enum Status {
    Ok,
    BadArgument,
    BadBlob,
    TooLarge,
    BadServo,
    UnknownAction,
    BadDuration,
    QueueFull,
}

/// `karakuri_state_t`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
#[allow(missing_docs, reason = "the header says it")]
pub enum State {
    Released,
    Faulted,
    Held,
    Moving,
    Resting,
}

/// `karakuri_dials_t`.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
#[allow(missing_docs, reason = "the header says it")]
pub struct CDials {
    pub intensity_q12: u16,
    pub rate_q12: u16,
    pub stillness_q12: u16,
    pub variety_q12: u16,
}

impl From<PlayError> for Status {
    fn from(error: PlayError) -> Self {
        match error {
            PlayError::QueueFull { .. } => Self::QueueFull,
            PlayError::Sample(SampleError::UnknownAction { .. }) => Self::UnknownAction,
            PlayError::Sample(_) => Self::BadDuration,
            _ => Self::TooLarge,
        }
    }
}

impl From<Result<(), PlayError>> for Status {
    fn from(outcome: Result<(), PlayError>) -> Self {
        outcome.err().map_or(Self::Ok, Self::from)
    }
}

/// Makes a body in `storage`.
///
/// # Safety
/// As the header says: `storage`, `blob` and what `body` points to outlive the body; `servos` has `servo_count`
/// entries.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn karakuri_init(
    body: *mut *mut Body,
    storage: *mut Storage,
    blob: *const u8,
    blob_bytes: usize,
    servos: *const CServo,
    servo_count: usize,
    seed: u64,
) -> Status {
    let is_null = body.is_null() || storage.is_null() || blob.is_null();
    let is_null = is_null || (servos.is_null() && servo_count > 0);
    if is_null || !storage.is_aligned() || !servos.is_aligned() {
        return Status::BadArgument;
    }
    // SAFETY: not null; the caller gives this length, and the blob outlives the body and does not change.
    let blob = unsafe { core::slice::from_raw_parts(blob, blob_bytes) };
    let servos = if servo_count == 0 {
        &[]
    } else {
        // SAFETY: not null where there are some, and the caller gives their number.
        unsafe { core::slice::from_raw_parts(servos, servo_count) }
    };
    // SAFETY: not null, aligned, as large as its type, which the header repeats, and nobody else's.
    match unsafe { Body::place(storage, blob, servos, seed) } {
        Ok(placed) => {
            // SAFETY: not null; the caller's own pointer.
            unsafe { body.write(placed) };
            Status::Ok
        }
        Err(status) => status,
    }
}

/// Number of an action, -1: none.
///
/// # Safety
/// As above; `name` ends with a zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn karakuri_action(body: *const Body, name: *const c_char) -> i32 {
    // SAFETY: see the top of this file.
    let Some(player) = (unsafe { Body::player(body) }).filter(|_| !name.is_null()) else {
        return -1;
    };
    // SAFETY: not null, and it ends with a zero.
    let name = unsafe { CStr::from_ptr(name) };
    let action = name.to_str().ok().and_then(|name| player.model().action_by_name(name));
    action.map_or(-1, |ActionId(action)| i32::from(action))
}

/// Plays a motion now.
///
/// # Safety
/// See the top of this file.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn karakuri_play(
    body: *mut Body,
    action: u16,
    duration_ms: u32,
    seed: u64,
) -> Status {
    // SAFETY: see the top of this file.
    let Some(player) = (unsafe { Body::player_mut(body) }) else { return Status::BadArgument };
    player.play(Intent::new(ActionId(action), duration_ms, seed)).into()
}

/// Plays a motion after those that wait.
///
/// # Safety
/// See the top of this file.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn karakuri_then(
    body: *mut Body,
    action: u16,
    duration_ms: u32,
    seed: u64,
) -> Status {
    // SAFETY: see the top of this file.
    let Some(player) = (unsafe { Body::player_mut(body) }) else { return Status::BadArgument };
    player.then(Intent::new(ActionId(action), duration_ms, seed)).into()
}

/// Whether the body moves on its own.
///
/// # Safety
/// See the top of this file.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn karakuri_idle(body: *mut Body, is_alive: bool) {
    // SAFETY: see the top of this file.
    let Some(player) = (unsafe { Body::player_mut(body) }) else { return };
    let count = if is_alive { player.model().manifest().action_count } else { 0 };
    player.idle((0..count).map(ActionId));
}

/// Turns the dials.
///
/// # Safety
/// See the top of this file.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn karakuri_set_dials(body: *mut Body, dials: CDials) {
    let CDials { intensity_q12, rate_q12, stillness_q12, variety_q12 } = dials;
    // SAFETY: see the top of this file.
    if let Some(player) = unsafe { Body::player_mut(body) } {
        player.set_dials(Dials { intensity_q12, rate_q12, stillness_q12, variety_q12 });
    }
}

/// Functions of a body that take and give nothing.
macro_rules! simple {
    ($($name:ident => $method:ident),*) => {$(
        #[doc = concat!("`Player::", stringify!($method), "`.")]
        ///
        /// # Safety
        /// See the top of this file.
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $name(body: *mut Body) {
            // SAFETY: see the top of this file.
            if let Some(player) = unsafe { Body::player_mut(body) } {
                player.$method();
            }
        }
    )*};
}

simple!(
    karakuri_hold => hold,
    karakuri_resume => resume,
    karakuri_soft_stop => soft_stop,
    karakuri_relax => relax,
    karakuri_wake => wake,
    karakuri_clear_fault => clear_fault
);

/// Lets time pass; returns how many pulses were written.
///
/// # Safety
/// As above; `pulses_us` has room for `count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn karakuri_tick(
    body: *mut Body,
    elapsed_us: u32,
    pulses_us: *mut u16,
    count: usize,
) -> usize {
    // SAFETY: see the top of this file.
    let Some(player) = (unsafe { Body::player_mut(body) }) else { return 0 };
    let command = player.tick(elapsed_us);
    if pulses_us.is_null() {
        return 0;
    }
    // SAFETY: not null, and the caller gives the room.
    let room = unsafe { core::slice::from_raw_parts_mut(pulses_us, count) };
    let written = room.iter_mut().zip(command.pulses_us());
    written.map(|(place, &pulse_us)| *place = pulse_us).count()
}

/// What the body does.
///
/// # Safety
/// See the top of this file.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn karakuri_state(body: *const Body) -> State {
    // SAFETY: see the top of this file.
    let Some(player) = (unsafe { Body::player(body) }) else { return State::Released };
    match player.state() {
        PlayerState::Released => State::Released,
        PlayerState::Faulted(_) => State::Faulted,
        PlayerState::Held => State::Held,
        PlayerState::Moving(_) => State::Moving,
        _ => State::Resting,
    }
}

/// Code of the latched fault, 0: none.
///
/// # Safety
/// See the top of this file.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn karakuri_fault(body: *const Body) -> u16 {
    // SAFETY: see the top of this file.
    match unsafe { Body::player(body) }.map(Player::state) {
        Some(PlayerState::Faulted(fault)) => fault.code(),
        _ => 0,
    }
}

/// Latches a fault of the caller's own.
///
/// # Safety
/// See the top of this file.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn karakuri_latch(body: *mut Body, number: u8) {
    // SAFETY: see the top of this file.
    if let Some(player) = unsafe { Body::player_mut(body) } {
        player.latch(Fault::External(number));
    }
}

/// Nothing in this crate panics; a linker wants to be told what would happen.
#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {
        core::hint::spin_loop();
    }
}
