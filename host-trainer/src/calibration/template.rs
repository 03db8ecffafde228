//! A calibration file to start from: every servo that a layout can have, with careful numbers.
//!
//! In:  the layout of a model.
//! Out: TOML text that `calibrate` accepts as it is.
//!
//! Why here: a builder corrects numbers faster than he invents keys. The range is narrow and the motion slow, because
//! the file is used before anything was measured.

use std::fmt::Write;

use crate::layout::{GroupKind, PoseLayout, Unit};

const HEAD: &str = "\
# Calibration of one robot: correct every number, then
#   host-trainer check CLIPS --calibration THIS.toml
#   host-trainer calibrate MODEL.kara --calibration THIS.toml --out CALIBRATED.kara
# Microseconds of pulse; a servo that turns the other way has reverse = true.

[pca9685]
oscillator_hz = 25_000_000 # measure a pulse of 1500 us: 25_000_000 * 1500 / what it is
";

const LIMITS: &str = "\
min_us = 1000
neutral_us = 1500 # where the channel is 0, or at `neutral_at`
max_us = 2000
park_us = 1500 # where it stands when nobody drives it, and starts
trim_us = 0
reverse = false
speed_us_per_s = 2000
acceleration_us_per_s2 = 20_000
";

/// The text.
pub fn template(layout: &PoseLayout) -> String {
    let mut text = HEAD.to_owned();
    let mut output = 0;
    for group in &layout.groups {
        let axes: &[&str] = match group.kind {
            GroupKind::Scalar => &[""],
            GroupKind::Rotation6d => &["z", "y", "x"],
            GroupKind::Translation | GroupKind::Position => &[],
        };
        for axis in axes {
            // Writing to a string cannot fail.
            let _ = write!(text, "\n[[servo]]\nchannel = {:?}\n", group.name);
            if !axis.is_empty() {
                let _ = writeln!(text, "axis = {axis:?}\norder = \"zyx\"");
            }
            let _ = writeln!(text, "output = {output}");
            let gain = match (group.kind, group.unit) {
                (GroupKind::Rotation6d, _) | (_, Unit::Degree | Unit::Radian) => {
                    "us_per_degree = 10.0\n"
                }
                (_, Unit::Microsecond) => "",
                _ => "us_per_unit = 10.0\n",
            };
            text += gain;
            text += LIMITS;
            output += 1;
        }
    }
    text
}
