//! Clips → curves in degrees, whatever their channels are, so that one tolerance means one thing.
//!
//! In:  a layout and poses.
//! Out: [`Hinges`] to `keyframe_bytes.rs`.
//!
//! Angles are taken as they are, pulses at 10 µs a degree, rotations as three angles (z, x, y) without jumps of a turn.
//! Lengths count as the angle of a link of 100 mm: 1.75 mm is a degree.

use crate::bake::servo::DEFAULT_US_PER_DEGREE;
use crate::body::rotation::Rotation;
use crate::export::bvh::euler_zxy_deg;
use crate::layout::{GroupKind, PoseLayout, Unit};

/// Length of the link whose end shows an error of angle, mm.
pub const LINK_MM: f64 = 100.0;

/// One clip as curves.
#[derive(Clone, Debug, PartialEq)]
pub struct Hinges {
    /// Poses.
    pub frame_count: usize,
    /// Degrees. // (curve), (frame)
    pub curves: Vec<Vec<f64>>,
}

impl Hinges {
    /// Every channel or angle of the clip that has a unit. // poses: (frame, channel)
    pub fn new(layout: &PoseLayout, poses: &[f32]) -> Self {
        let width = layout.channel_count().max(1);
        let mut curves = Vec::new();
        for (group, range) in layout.ranges() {
            let values = poses.chunks_exact(width).map(|pose| &pose[range.clone()]);
            match group.kind {
                GroupKind::Rotation6d => curves.extend(angles(values)),
                _ => {
                    let Some(factor) = degrees_per_unit(group.unit) else { continue };
                    let column =
                        |index: usize| values.clone().map(move |v| f64::from(v[index]) * factor);
                    curves.extend((0..range.len()).map(|index| column(index).collect::<Vec<_>>()));
                }
            }
        }
        Self { frame_count: poses.len() / width, curves }
    }
}

/// Three curves of angles; a step of more than half a turn is taken as the shorter way round.
fn angles<'p>(values: impl Iterator<Item = &'p [f32]>) -> Vec<Vec<f64>> {
    let mut curves = vec![Vec::new(); 3];
    for value in values {
        let rows: [f64; 6] = std::array::from_fn(|index| f64::from(value[index]));
        for (curve, angle) in curves.iter_mut().zip(euler_zxy_deg(&Rotation::from_6d(&rows))) {
            let before = curve.last().copied().unwrap_or(angle);
            curve.push(angle - ((angle - before) / 360.0).round() * 360.0);
        }
    }
    curves
}

fn degrees_per_unit(unit: Unit) -> Option<f64> {
    let per_mm = (1.0 / LINK_MM).atan().to_degrees();
    match unit {
        Unit::Degree => Some(1.0),
        Unit::Radian => Some(1f64.to_degrees()),
        Unit::Microsecond => Some(1.0 / DEFAULT_US_PER_DEGREE),
        Unit::Millimetre => Some(per_mm),
        Unit::Centimetre => Some(10.0 * per_mm),
        Unit::Metre => Some(1000.0 * per_mm),
        Unit::One => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::Group;

    fn layout(groups: &[(GroupKind, Unit)]) -> PoseLayout {
        let group = |(kind, unit): &(_, _)| Group { name: "a".into(), kind: *kind, unit: *unit };
        PoseLayout { groups: groups.iter().map(group).collect() }
    }

    #[test]
    fn units_become_degrees_and_numbers_without_unit_are_left_out() {
        let layout = layout(&[
            (GroupKind::Scalar, Unit::Radian),
            (GroupKind::Scalar, Unit::One),
            (GroupKind::Scalar, Unit::Microsecond),
            (GroupKind::Position, Unit::Metre),
        ]);
        let hinges = Hinges::new(&layout, &[1.0, 9.0, 25.0, 0.00175, 0.0, 0.0]);
        assert_eq!((hinges.frame_count, hinges.curves.len()), (1, 5));
        assert!((hinges.curves[0][0] - 57.2958).abs() < 1e-3 && hinges.curves[1][0] == 2.5);
        assert!((hinges.curves[2][0] - 1.0).abs() < 0.01);
    }

    #[test]
    fn turns_do_not_jump() {
        let layout = layout(&[(GroupKind::Rotation6d, Unit::One)]);
        let poses: Vec<f32> = (0..80)
            .flat_map(|frame| {
                let (sine, cosine) = (frame as f32 * 0.1).sin_cos();
                [cosine, -sine, 0.0, sine, cosine, 0.0]
            })
            .collect();
        let curves = Hinges::new(&layout, &poses).curves;
        assert!(curves[0].windows(2).all(|pair| (pair[1] - pair[0] - 5.7296).abs() < 0.01));
    }
}
