//! Station 9: all channels at one instant.

use crate::limits::CHANNELS_MAX;

/// Channel values in the units of the model's layout, each Q15.16 (1 is 65,536).
///
/// The layout (`Model::groups`) says what each channel is. 4 bytes a channel up to the limit; no heap.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pose {
    pub(crate) channels: heapless::Vec<i32, CHANNELS_MAX>,
}

/// Values beyond [`CHANNELS_MAX`] are dropped.
impl FromIterator<i32> for Pose {
    fn from_iter<Values: IntoIterator<Item = i32>>(values: Values) -> Self {
        Self { channels: values.into_iter().take(CHANNELS_MAX).collect() }
    }
}

impl Pose {
    /// Fraction bits of a channel value.
    pub const FRACTION_BITS: u32 = 16;

    /// A pose without channels, to be filled by `Decoder::decode`.
    pub const fn new() -> Self {
        Self { channels: heapless::Vec::new() }
    }

    /// The channels, in layout order.
    pub fn channels(&self) -> &[i32] {
        &self.channels
    }

    /// The channels as floats, for hosts and parts with an FPU; exact in f64.
    pub fn values(&self) -> impl ExactSizeIterator<Item = f64> + '_ {
        self.channels.iter().map(|&value| f64::from(value) / 65_536.0)
    }
}
