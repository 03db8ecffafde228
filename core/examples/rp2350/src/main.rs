//! A body at a Raspberry Pi Pico 2: eleven servos at a PCA9685, SDA at GP4, SCL at GP5.

#![no_std]
#![no_main]

use body::{Space, TICK_US};
use embassy_executor::Spawner;
use embassy_rp::bind_interrupts;
use embassy_rp::i2c::{Config, I2c, InterruptHandler};
use embassy_rp::peripherals::I2C0;
use embassy_time::{Delay, Duration, Instant, Ticker};
use karakuri::output::{Pca9685, Pca9685Settings};
use panic_halt as _;

bind_interrupts!(struct Interrupts {
    I2C0_IRQ => InterruptHandler<I2C0>;
});

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let chip = embassy_rp::init(Default::default());
    let mut config = Config::default();
    config.frequency = 400_000;
    let bus = I2c::new_async(chip.I2C0, chip.PIN_5, chip.PIN_4, Interrupts, config);
    // Measure the frequency of your board's oscillator, see `Pca9685Settings`.
    let settings = Pca9685Settings { oscillator_hz: 25_000_000, ..Pca9685Settings::default() };
    let board = Pca9685::start_async(bus, settings, &mut Delay).await;
    let mut board = board.expect("a PCA9685 that answers");
    let (model, mut space) = (body::model(), Space::new());
    let mut body = body::body(&model, &mut space, 7);
    body.wake();
    let mut ticker = Ticker::every(Duration::from_micros(TICK_US.into()));
    let mut last = Instant::now();
    loop {
        ticker.next().await;
        let now = Instant::now();
        let elapsed_us = u32::try_from((now - last).as_micros()).unwrap_or(u32::MAX);
        last = now;
        let pulses_us = body.tick(elapsed_us).pulses_us();
        // What fails is written again by the next tick.
        let _ = board.write_async(pulses_us).await;
    }
}
