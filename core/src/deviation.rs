//! What tests of numeric functions assert: the largest and the RMS error of many.

/// Errors seen so far, in whatever unit they were added.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Deviation {
    max: f64,
    squares: f64,
    count: f64,
}

impl Deviation {
    /// Takes one more error.
    pub(crate) fn add(&mut self, error: f64) {
        self.max = self.max.max(error.abs());
        self.squares += error * error;
        self.count += 1.0;
    }

    /// The largest magnitude.
    pub(crate) fn max(&self) -> f64 {
        self.max
    }

    /// Root of the mean square.
    pub(crate) fn rms(&self) -> f64 {
        libm::sqrt(self.squares / self.count)
    }

    /// Panics with both figures when one of them is above its bound, or both are far below it: a
    /// stated accuracy is neither exceeded nor out of date.
    pub(crate) fn assert_at_most(&self, max: f64, rms: f64) {
        let (got_max, got_rms) = (self.max, self.rms());
        assert!(got_max <= max && got_rms <= rms, "max {got_max}, RMS {got_rms}");
        assert!(got_max > 0.7 * max || got_rms > 0.7 * rms, "only {got_max}, RMS {got_rms}");
    }
}
