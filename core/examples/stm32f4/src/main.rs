//! Four servos at an STM32F411 ("Black Pill"), without an extra board: PA8, PA9, PA10, PA11 are outputs of timer 1.
//!
//! The other joints of the body are worked out and go nowhere.

#![no_std]
#![no_main]

use body::{Space, TICK_US};
use cortex_m_rt::entry;
use karakuri::output::PwmServo;
use panic_halt as _;
use stm32f4xx_hal::pac::Peripherals;
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::rcc::Config;

#[entry]
fn main() -> ! {
    let chip = Peripherals::take().expect("taken once");
    let mut rcc = chip.RCC.freeze(Config::hsi().sysclk(96.MHz()));
    let pins = chip.GPIOA.split(&mut rcc);
    let (_, outputs) = chip.TIM1.pwm_us(20_000.micros(), &mut rcc);
    let (mut a, mut b, mut c, mut d) = (
        outputs.0.with(pins.pa8),
        outputs.1.with(pins.pa9),
        outputs.2.with(pins.pa10),
        outputs.3.with(pins.pa11),
    );
    a.enable();
    b.enable();
    c.enable();
    d.enable();
    let mut servos = (
        PwmServo::new(a, 20_000),
        PwmServo::new(b, 20_000),
        PwmServo::new(c, 20_000),
        PwmServo::new(d, 20_000),
    );
    let mut clock = chip.TIM5.counter_us(&mut rcc);
    clock.start(u32::MAX.micros()).expect("a timer of 32 bits");
    let (model, mut space) = (body::model(), Space::new());
    let mut body = body::body(&model, &mut space, 7);
    body.wake();
    let mut last_us = 0;
    loop {
        let elapsed_us = clock.now().ticks().wrapping_sub(last_us);
        if elapsed_us < TICK_US {
            continue;
        }
        last_us = last_us.wrapping_add(elapsed_us);
        if let [a, b, c, d, ..] = *body.tick(elapsed_us).pulses_us() {
            let _ = (servos.0.write(a), servos.1.write(b), servos.2.write(c), servos.3.write(d));
        }
    }
}
