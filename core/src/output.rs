//! Station 11: servo command → whatever makes servos move.
//!
//! In:  pulses of a [`ServoCommand`](crate::ServoCommand), microseconds; 0 releases a servo.
//! Out: duty cycles of PWM outputs, registers of a PCA9685, frames of a bus of serial servos.
//!
//! Why here: rounding a pulse to a timer's steps, releasing, and sending again what failed are the same on every
//! chip. Nothing is remembered as written that was not: after an error the next write sends it, so the last target
//! arrives.

#[cfg(feature = "embedded-hal-1")]
mod pwm_servo;
mod arrangement;
mod dynamixel;
mod feetech;
mod packet;
#[cfg(any(feature = "embedded-hal-1", feature = "embedded-hal-async-1"))]
mod pca9685;

pub use arrangement::arrange;
pub use dynamixel::Dynamixel;
pub use feetech::Feetech;
pub use packet::BufferTooSmall;
#[cfg(any(feature = "embedded-hal-1", feature = "embedded-hal-async-1"))]
pub use pca9685::{Pca9685, Pca9685Error, Pca9685Settings};
#[cfg(feature = "embedded-hal-1")]
pub use pwm_servo::PwmServo;
