//! Both drivers against a bus that expects exactly these bytes.

use core::future::Future;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::vec;
use std::vec::Vec;

use embedded_hal::i2c::ErrorKind;
use embedded_hal_mock::eh1::delay::NoopDelay;
use embedded_hal_mock::eh1::i2c::{Mock, Transaction};

use super::*;

const SETTINGS: Pca9685Settings =
    Pca9685Settings { address: 0x41, oscillator_hz: 25_000_000, rate_hz: 50 };

fn write(bytes: &[u8]) -> Transaction {
    Transaction::write(0x41, bytes.to_vec())
}

fn start_up() -> Vec<Transaction> {
    [[0xFD, 0x10], [0x00, 0x30], [0xFE, 121], [0x01, 0x04], [0x00, 0x20]].map(|b| write(&b)).into()
}

/// A chip that started and then expects these.
fn started(expected: &[Transaction]) -> Pca9685<Mock> {
    let all = [start_up(), expected.to_vec()].concat();
    Pca9685::start(Mock::new(&all), SETTINGS, &mut NoopDelay::new()).expect("a bus that works")
}

/// Polls a future that is always ready.
fn ready<T>(future: impl Future<Output = T>) -> T {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => value,
        Poll::Pending => panic!("a mock never waits"),
    }
}

#[test]
fn oscillator_and_rate_that_no_chip_has_are_refused_before_the_bus_is_touched() {
    let start = |settings| {
        let mut bus = Mock::new(&[]);
        bus.done();
        Pca9685::start(bus, settings, &mut NoopDelay::new()).err()
    };
    let oscillator_hz = 25;
    let refused = start(Pca9685Settings { oscillator_hz, ..SETTINGS });
    assert_eq!(refused, Some(Pca9685Error::BadOscillator { oscillator_hz }));
    let refused = start(Pca9685Settings { rate_hz: 20, ..SETTINGS });
    assert_eq!(refused, Some(Pca9685Error::BadRate { rate_hz: 20 }));
}

#[test]
fn bus_that_fails_at_the_start_is_reported() {
    let mut bus = Mock::new(&[write(&[0xFD, 0x10]).with_error(ErrorKind::Bus)]);
    let failed = Pca9685::start(bus.clone(), SETTINGS, &mut NoopDelay::new()).err();
    assert_eq!(failed, Some(Pca9685Error::Bus(ErrorKind::Bus)));
    bus.done();
}

#[test]
fn pulses_that_failed_are_written_again_although_nothing_changed() {
    // 1500 µs are 307.4 steps of 4.88 µs.
    let burst = write(&[0x06, 0, 0, 51, 1, 0, 0, 51, 1]);
    let failed = burst.clone().with_error(ErrorKind::ArbitrationLoss);
    let both_again = burst.clone();
    let mut chip = started(&[write(&off()), failed, both_again]);
    chip.write(&[0; 16]).unwrap();
    assert_eq!(chip.write(&[1500, 1500]), Err(Pca9685Error::Bus(ErrorKind::ArbitrationLoss)));
    chip.write(&[1500, 1500]).unwrap();
    chip.write(&[1500, 1500]).unwrap();
    chip.release().done();
}

/// All outputs fully off.
fn off() -> Vec<u8> {
    let mut bytes = vec![0x06];
    (0..16).for_each(|_| bytes.extend([0, 0, 0, 0x10]));
    bytes
}

#[test]
fn first_write_says_everything_and_later_ones_what_changed() {
    let mut first = off();
    first[1..5].copy_from_slice(&[0, 0, 51, 1]);
    let from_second_to_fourth = [0x06 + 4, 0, 0, 205, 0, 0, 0, 0, 0x10, 0, 0, 154, 1];
    let mut chip =
        started(&[write(&first), write(&from_second_to_fourth), write(&[6, 0, 0, 0, 16])]);
    chip.write(&[1500]).unwrap();
    chip.write(&[1500, 1000, 0, 2002]).unwrap();
    chip.write(&[0, 1001, 0, 2002]).unwrap();
    chip.release().done();
}

#[test]
fn chip_that_lost_its_supply_is_told_everything_again() {
    let mut chip = started(&[write(&off()), write(&off())]);
    chip.write(&[]).unwrap();
    chip.write(&[]).unwrap();
    chip.forget();
    chip.write(&[]).unwrap();
    chip.release().done();
}

#[test]
fn pulses_beyond_the_sixteenth_are_left_out_and_long_ones_end_before_the_period() {
    let mut bytes = off();
    bytes[61..65].copy_from_slice(&[0, 0, 0xFF, 0x0F]);
    let mut chip = started(&[write(&bytes)]);
    let mut pulses_us = [0; 20];
    pulses_us[15] = u16::MAX;
    pulses_us[16] = 1500;
    chip.write(&pulses_us).unwrap();
    chip.release().done();
}

#[test]
fn asynchronous_driver_writes_the_same_and_repeats_what_failed() {
    let burst = write(&[0x06, 0, 0, 51, 1]);
    let failed = burst.clone().with_error(ErrorKind::Bus);
    let all = [start_up(), vec![write(&off()), failed, burst]].concat();
    let mut delay = NoopDelay::new();
    let mut chip = ready(Pca9685::start_async(Mock::new(&all), SETTINGS, &mut delay)).unwrap();
    ready(chip.write_async(&[])).unwrap();
    assert_eq!(ready(chip.write_async(&[1500])), Err(Pca9685Error::Bus(ErrorKind::Bus)));
    ready(chip.write_async(&[1500])).unwrap();
    ready(chip.write_async(&[1500])).unwrap();
    chip.release().done();
}
