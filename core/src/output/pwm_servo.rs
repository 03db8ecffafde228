//! One servo at one PWM output of the chip.

use embedded_hal::pwm::{ErrorType, SetDutyCycle};

/// A servo at any output that implements `SetDutyCycle`.
#[derive(Clone, Debug)]
pub struct PwmServo<P> {
    output: P,
    period_us: u16,
    /// Duty that the output is known to have.
    written: Option<u16>,
}

impl<P: SetDutyCycle> PwmServo<P> {
    /// A servo at an output that was set up for a period of `period_us`, 20,000 for most servos. The output is not
    /// touched before the first [`write`](Self::write).
    pub const fn new(output: P, period_us: u16) -> Self {
        Self { output, period_us, written: None }
    }

    /// Makes pulses of `pulse_us`, 0: none, if it does not make them already.
    ///
    /// # Accuracy
    /// Nearest step of the timer, ties up: half a period / maximum duty, 0.15 µs at 16 bits and 20 ms. A pulse longer
    /// than the period becomes the period.
    ///
    /// # Errors
    /// What the output says; the next call sets it again.
    pub fn write(&mut self, pulse_us: u16) -> Result<(), <P as ErrorType>::Error> {
        let duty = duty(pulse_us, self.period_us, self.output.max_duty_cycle());
        if self.written == Some(duty) {
            return Ok(());
        }
        self.written = None;
        self.output.set_duty_cycle(duty)?;
        self.written = Some(duty);
        Ok(())
    }

    /// The output, as it is now.
    pub fn release(self) -> P {
        self.output
    }
}

/// Nearest to `pulse_us / period_us · duty_max`.
fn duty(pulse_us: u16, period_us: u16, duty_max: u16) -> u16 {
    let period = u32::from(period_us.max(1));
    let pulse = u32::from(pulse_us).min(period);
    // At most 65,535² + 32,767.
    let rounded = (pulse * u32::from(duty_max) + period / 2) / period;
    // At most the maximum, because the pulse is at most the period.
    rounded as u16
}

#[cfg(test)]
mod tests {
    use embedded_hal_mock::eh1::MockError;
    use embedded_hal_mock::eh1::pwm::{Mock, Transaction};
    use proptest::prelude::*;
    use std::io::ErrorKind;

    use super::*;

    const MAX: u16 = 40_000;

    fn servo(duties: &[Transaction]) -> PwmServo<Mock> {
        PwmServo::new(Mock::new(duties), 20_000)
    }

    fn max() -> Transaction {
        Transaction::max_duty_cycle(MAX)
    }

    fn set(duty: u16) -> Transaction {
        Transaction::set_duty_cycle(duty)
    }

    #[test]
    fn pulse_that_failed_is_written_again() {
        let failed = set(3000).with_error(MockError::Io(ErrorKind::Other));
        let mut servo = servo(&[max(), failed, max(), set(3000)]);
        assert!(servo.write(1500).is_err());
        assert_eq!(servo.write(1500), Ok(()));
        servo.release().done();
    }

    #[test]
    fn same_pulse_is_written_once_and_release_is_no_pulse() {
        let mut servo = servo(&[max(), set(3000), max(), max(), set(0)]);
        for pulse_us in [1500, 1500, 0] {
            servo.write(pulse_us).unwrap();
        }
        servo.release().done();
    }

    proptest! {
        #[test]
        fn duty_is_the_nearest_step_inside_the_range(pulse_us: u16, period_us in 1_u16.., max: u16) {
            let duty = duty(pulse_us, period_us, max);
            let exact = f64::from(pulse_us.min(period_us)) * f64::from(max) / f64::from(period_us);
            prop_assert!(duty <= max && (f64::from(duty) - exact).abs() <= 0.5, "{} {}", duty, exact);
        }
    }
}
