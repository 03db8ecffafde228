//! Calibration in the blob: the servos that stand behind the tensors.
//!
//! ```text
//! 0   frequency of the PCA9685's oscillator u32, Hz
//! 4   one record a servo:
//!     0   channel u16        2   input u8 (0 channel, 1 angle, 2 twist)      3   order · 4 + axis u8
//!     4   shortest u16       6   neutral u16       8   longest u16       10  park u16, µs
//!     12  trim i16, µs       14  output u8         15  zero
//!     16  gain i32, Q15.16 µs a unit               20  channel value at neutral i32, Q15.16
//!     24  speed u32, µs/s    28  acceleration u32, µs/s²
//! ```
//!
//! Why here: behind everything else and of fixed size, so that a robot can be calibrated again without its model being
//! touched; blobs without servos stay blobs of version 2, byte for byte.

use crate::blob::{self, Envelope};
use crate::error::{BlobError, ServoError};
use crate::limits::SERVOS_MAX;
use crate::little_endian::u16s;
use crate::model::Model;
use crate::rotation::{Axis, AxisOrder};
use crate::servo_map::{ServoInput, ServoLimits, ServoMap};

/// What a PCA9685 says of itself, Hz; found are 23 to 27 MHz.
pub const OSCILLATOR_HZ: u32 = 25_000_000;
/// The fastest clock that a PCA9685 takes from outside, Hz.
const OSCILLATOR_HZ_MAX: u32 = 50_000_000;

const RECORD_BYTES: usize = 32;
const FREQUENCY_BYTES: usize = 4;
const AXES: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];

/// Bytes that calibration of so many servos adds to a blob.
pub const fn servos_bytes(count: usize) -> usize {
    FREQUENCY_BYTES + RECORD_BYTES * count
}

/// Writes `bytes`, a blob with or without servos, with these servos to the front of `output`; returns its length.
///
/// # Errors
/// What is wrong with the blob from outside; [`BlobError::OverLimit`]: too many servos; [`BlobError::WrongLength`]:
/// `output` is too small. The result still has to pass `Model::from_bytes`.
pub fn with_servos(
    bytes: &[u8],
    servos: &[ServoMap],
    oscillator_hz: u32,
    output: &mut [u8],
) -> Result<usize, BlobError> {
    if servos.len() > SERVOS_MAX {
        let (value, max) = (servos.len() as u32, SERVOS_MAX as u32);
        return Err(BlobError::OverLimit { field: "servos", value, max });
    }
    let model = Envelope::parse(bytes)?.bytes;
    let expected = model.len() + servos_bytes(servos.len());
    let too_small = BlobError::WrongLength { found: output.len(), expected };
    let blob = output.get_mut(..expected).ok_or(too_small)?;
    let (front, section) = blob.split_at_mut(model.len());
    front.copy_from_slice(model);
    let (frequency, records) = section.split_at_mut(FREQUENCY_BYTES);
    frequency.copy_from_slice(&oscillator_hz.to_le_bytes());
    for (record, servo) in records.chunks_exact_mut(RECORD_BYTES).zip(servos) {
        record.copy_from_slice(&record_of(servo));
    }
    blob::seal_with_servos(blob, servos_bytes(servos.len())).ok_or(too_small)?;
    Ok(expected)
}

impl<'a> Model<'a> {
    /// Calibration of the robot's servos; none where the blob was not calibrated. For
    /// [`ServoStage::from_maps`](crate::ServoStage::from_maps).
    pub fn servos(&self) -> impl Iterator<Item = ServoMap> + use<'a> {
        self.servos.servos()
    }

    /// Frequency of the oscillator of the robot's PCA9685, 25 MHz where the blob was not calibrated.
    pub fn pca9685_oscillator_hz(&self) -> u32 {
        self.servos.oscillator_hz()
    }
}

/// What stands behind the tensors; empty in blobs of version 2.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ServoRecords<'a> {
    bytes: &'a [u8],
}

impl<'a> ServoRecords<'a> {
    /// Checks every record; poses have `channel_count` channels.
    #[inline(never)]
    pub fn load(bytes: &'a [u8], channel_count: usize) -> Result<Self, BlobError> {
        let loaded = Self { bytes };
        if bytes.is_empty() {
            return Ok(loaded);
        }
        let records = bytes.len().saturating_sub(FREQUENCY_BYTES);
        let is_whole = bytes.len() >= FREQUENCY_BYTES && records.is_multiple_of(RECORD_BYTES);
        if !is_whole || records > SERVOS_MAX * RECORD_BYTES {
            return Err(BlobError::BadField {
                field: "bytes of servos",
                value: bytes.len() as u32,
            });
        }
        let oscillator_hz = loaded.oscillator_hz();
        if oscillator_hz == 0 || oscillator_hz > OSCILLATOR_HZ_MAX {
            return Err(BlobError::BadField { field: "PCA9685 oscillator", value: oscillator_hz });
        }
        for (index, record) in loaded.records().enumerate() {
            let servo = index as u16;
            let Some(map) = servo_of(record) else {
                return Err(BlobError::BadField { field: "servo", value: index as u32 });
            };
            let map = map.map_err(|error| BlobError::BadServo { servo, error })?;
            if usize::from(map.channel()) + map.input().channel_count() > channel_count {
                return Err(BlobError::BadField { field: "channel of servo", value: index as u32 });
            }
        }
        Ok(loaded)
    }

    pub fn oscillator_hz(self) -> u32 {
        self.bytes.first_chunk().map_or(OSCILLATOR_HZ, |bytes| u32::from_le_bytes(*bytes))
    }

    pub fn servos(self) -> impl Iterator<Item = ServoMap> + use<'a> {
        // All of them can be read: `load` has.
        self.records().filter_map(|record| servo_of(record)?.ok())
    }

    fn records(self) -> impl Iterator<Item = &'a [u8; RECORD_BYTES]> + use<'a> {
        let records = self.bytes.get(FREQUENCY_BYTES..).unwrap_or_default();
        records.as_chunks().0.iter()
    }
}

fn record_of(servo: &ServoMap) -> [u8; RECORD_BYTES] {
    let [min, neutral, max] = servo.pulses_us();
    let number_of = |axis: Axis| AXES.iter().position(|&found| found == axis).unwrap_or(0) as u8;
    let (input, detail) = match servo.input() {
        ServoInput::Channel => (0, 0),
        ServoInput::Angle { order, axis } => {
            let order = AxisOrder::ALL.iter().position(|&found| found == order).unwrap_or(0);
            (1, order as u8 * 4 + number_of(axis))
        }
        ServoInput::Twist(axis) => (2, number_of(axis)),
    };
    let mut record = [0; RECORD_BYTES];
    let mut bytes = record.iter_mut();
    let mut put = |field: &[u8]| field.iter().zip(&mut bytes).for_each(|(from, to)| *to = *from);
    put(&servo.channel().to_le_bytes());
    put(&[input, detail]);
    for pulse_us in [min, neutral, max, servo.pulse_us_park()] {
        put(&pulse_us.to_le_bytes());
    }
    put(&servo.trim_us().to_le_bytes());
    put(&[servo.output(), 0]);
    put(&servo.pulse_us_per_unit_q16().to_le_bytes());
    put(&servo.channel_at_neutral_q16().to_le_bytes());
    put(&servo.limits().pulse_us_per_s_max.to_le_bytes());
    put(&servo.limits().pulse_us_per_s2_max.to_le_bytes());
    record
}

/// `None` where a record is none; an error where its calibration cannot be.
fn servo_of(record: &[u8; RECORD_BYTES]) -> Option<Result<ServoMap, ServoError>> {
    let mut halves = u16s(record);
    let mut half = || halves.next().unwrap_or(0);
    let channel = half();
    let [input, detail] = half().to_le_bytes();
    let pulses_us = [half(), half(), half()];
    let (park_us, trim_us) = (half(), half().cast_signed());
    let [output, zero] = half().to_le_bytes();
    let mut word = || u32::from(half()) | u32::from(half()) << 16;
    let (gain, neutral_at) = (word().cast_signed(), word().cast_signed());
    let limits = ServoLimits { pulse_us_per_s_max: word(), pulse_us_per_s2_max: word() };
    let axis = AXES.get(usize::from(detail % 4)).copied()?;
    let order = AxisOrder::ALL.get(usize::from(detail / 4)).copied()?;
    let input = match (input, detail) {
        (0, 0) => ServoInput::Channel,
        (1, _) => ServoInput::Angle { order, axis },
        (2, 0..4) => ServoInput::Twist(axis),
        _ => return None,
    };
    if zero != 0 {
        return None;
    }
    let map = ServoMap::new(channel, pulses_us, gain, limits)
        .and_then(|map| map.with_park_at(park_us)?.with_trim(trim_us));
    Some(map.map(|map| map.with_neutral_at(neutral_at).on_output(output).following(input)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blob::{HEADER_BYTES, seal_again};
    use crate::manifest::{NumberFormat, SamplerKind};
    use crate::specimen::specimen;
    use std::vec::Vec;

    const LIMITS: ServoLimits =
        ServoLimits { pulse_us_per_s_max: 6000, pulse_us_per_s2_max: 60_000 };

    fn jaw() -> ServoMap {
        let map = ServoMap::new(3, [600, 1400, 2400], -700_000, LIMITS).unwrap();
        let map = map.with_park_at(1000).unwrap().with_trim(-33).unwrap();
        map.with_neutral_at(-5).on_output(17)
    }

    fn calibrated(blob: &[u8], servos: &[ServoMap]) -> Result<Vec<u8>, BlobError> {
        let mut output = std::vec![0xAA; 8192];
        let length = with_servos(blob, servos, 26_500_000, &mut output)?;
        output.truncate(length);
        Ok(output)
    }

    fn blob() -> Vec<u8> {
        specimen(NumberFormat::W8A16, SamplerKind::ClipCodes)
    }

    /// What loading says after a change behind the tensors.
    fn refusal(change: impl FnOnce(&mut [u8])) -> BlobError {
        let mut blob = calibrated(&blob(), &[jaw()]).unwrap();
        let start = blob.len() - servos_bytes(1);
        change(&mut blob[start..]);
        seal_again(&mut blob);
        Model::from_bytes(&blob).unwrap_err()
    }

    #[test]
    fn record_of_nothing_known_is_refused() {
        let bad = |field, value| BlobError::BadField { field, value };
        // Input, its detail, the byte that is zero.
        for (offset, value) in [(6, 3), (7, 1), (19, 1)] {
            assert_eq!(refusal(|section| section[offset] = value), bad("servo", 0));
        }
        assert_eq!(refusal(|section| section[..4].fill(0)), bad("PCA9685 oscillator", 0));
        // Channel 4 of 4; a rotation of six from channel 3.
        assert_eq!(refusal(|section| section[4] = 4), bad("channel of servo", 0));
        assert_eq!(refusal(|section| section[6] = 2), bad("channel of servo", 0));
    }

    #[test]
    fn servo_that_no_builder_may_have_is_refused_by_its_name() {
        let swapped = ServoError::PulsesOutOfOrder { channel: 3, pulses_us: [600, 1400, 768] };
        let error = refusal(|section| section[12..14].copy_from_slice(&[0, 3]));
        assert_eq!(error, BlobError::BadServo { servo: 0, error: swapped });
        let park = refusal(|section| section[14..16].fill(0));
        assert!(matches!(park, BlobError::BadServo { error: ServoError::ParkOutside { .. }, .. }));
    }

    #[test]
    fn bytes_that_are_no_whole_servos_are_refused() {
        for change in [1u8, 255] {
            let mut blob = calibrated(&blob(), &[jaw()]).unwrap();
            blob[20] = blob[20].wrapping_add(change);
            seal_again(&mut blob);
            assert!(Model::from_bytes(&blob).is_err());
        }
        // Version 2 has no room for servos.
        let mut blob = calibrated(&blob(), &[jaw()]).unwrap();
        blob[4] = 2;
        seal_again(&mut blob);
        let error = Model::from_bytes(&blob).unwrap_err();
        assert_eq!(error, BlobError::BadField { field: "reserved header bytes", value: 0 });
    }

    #[test]
    fn more_servos_than_the_limit_are_refused() {
        let error = calibrated(&blob(), &[jaw(); SERVOS_MAX + 1]).unwrap_err();
        assert_eq!(error, BlobError::OverLimit { field: "servos", value: 33, max: 32 });
    }

    #[test]
    fn servos_are_what_was_written_and_the_model_is_untouched() {
        let (axis, order) = (Axis::Y, AxisOrder::Zxy);
        let servos = [jaw(), jaw().on_output(3)];
        let plain = blob();
        let blob = calibrated(&plain, &servos).unwrap();
        let model = Model::from_bytes(&blob).unwrap();
        assert_eq!(model.servos().collect::<Vec<_>>(), servos);
        assert_eq!(model.pca9685_oscillator_hz(), 26_500_000);
        assert_eq!(blob[HEADER_BYTES..plain.len()], plain[HEADER_BYTES..]);
        for map in [jaw(), jaw().following_angle(order, axis), jaw().following_twist(axis)] {
            assert_eq!(servo_of(&record_of(&map)), Some(Ok(map)));
        }
    }

    /// Blobs in the field are read as long as this stands.
    #[test]
    fn bytes_of_a_servo_are_these() {
        let head = jaw().following_angle(AxisOrder::Zxy, Axis::Y).on_output(17);
        let expected = [
            [3, 0, 1, 9, 0x58, 2, 0x78, 5],
            [0x60, 9, 0xE8, 3, 0xDF, 0xFF, 17, 0],
            [0xA0, 0x51, 0xF5, 0xFF, 0xFB, 0xFF, 0xFF, 0xFF],
            [0x70, 0x17, 0, 0, 0x60, 0xEA, 0, 0],
        ];
        assert_eq!(record_of(&head), *expected.as_flattened());
    }

    #[test]
    fn calibrating_again_replaces_the_servos() {
        let once = calibrated(&blob(), &[jaw(); 5]).unwrap();
        let twice = calibrated(&once, &[jaw()]).unwrap();
        assert_eq!(twice, calibrated(&blob(), &[jaw()]).unwrap());
    }

    #[test]
    fn blob_without_servos_is_of_version_2_and_has_none() {
        let blob = blob();
        let model = Model::from_bytes(&blob).unwrap();
        assert_eq!((blob[4], model.servos().count()), (2, 0));
        assert_eq!(model.pca9685_oscillator_hz(), OSCILLATOR_HZ);
    }
}
