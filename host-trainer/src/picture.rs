//! Generated motions → one picture that shows at a glance whether they live.
//!
//! In:  [`Motion`]s of one layout, from `generate`.
//! Out: an SVG contact sheet: skeleton figures over time for bodies, small curves for everything
//! else.

pub mod svg;
pub mod view;
pub mod stick_figures;
pub mod curves;
pub mod front;

use std::path::Path;

use crate::atomic_file::{self, Overwrite};
use crate::error::{Error, Result};
use crate::export::Motion;

/// Draws a contact sheet.
///
/// # Errors
/// - No motion, a motion without poses, or motions of different layouts.
pub fn contact_sheet(motions: &[Motion], title: &str) -> Result<String> {
    let Some(first) = motions.first() else {
        return Err(Error::bad_input(
            "contact sheet",
            "number of motions",
            0,
            "at least 1",
            "raise --count",
        ));
    };
    for (index, motion) in motions.iter().enumerate() {
        if motion.layout != first.layout || motion.frame_count() == 0 {
            return Err(Error::bad_input(
                "contact sheet",
                format!("motion {index}"),
                format!(
                    "{} poses of {} channels",
                    motion.frame_count(),
                    motion.layout.channel_count()
                ),
                "at least one pose, of the first motion's layout",
                "draw motions of different models apart",
            ));
        }
    }
    let joints: Option<Vec<_>> = motions.iter().map(Motion::joint_positions).collect();
    Ok(match joints {
        Some(joints) => stick_figures::draw(motions, &joints, title),
        None => curves::draw(motions, title),
    })
}

/// Draws a contact sheet into a file, whole or not at all.
///
/// # Errors
/// Those of [`contact_sheet`] and of writing.
pub fn write(motions: &[Motion], title: &str, path: &Path, overwrite: Overwrite) -> Result<()> {
    let sheet = contact_sheet(motions, title)?;
    atomic_file::write(path, sheet.as_bytes(), overwrite)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::skeleton::Skeleton;
    use crate::layout::{Group, GroupKind, PoseLayout, Unit};

    fn motion(kinds: &[GroupKind], frame_count: usize) -> Motion {
        let groups = kinds
            .iter()
            .enumerate()
            .map(|(index, kind)| Group {
                name: format!("g{index}"),
                kind: *kind,
                unit: Unit::Metre,
            })
            .collect();
        let layout = PoseLayout { groups };
        Motion {
            poses: (0..frame_count * layout.channel_count())
                .map(|x| (x as f32 * 0.37).sin())
                .collect(),
            layout,
            skeleton: None,
            rate_hz: 50.0,
            action: "wave & <bow>".to_owned(),
            seconds: 1.0,
            seed: 7,
            provenance: "test".to_owned(),
        }
    }

    #[test]
    fn sheet_of_nothing_is_refused() {
        assert!(contact_sheet(&[], "t").is_err());
        let empty = motion(&[GroupKind::Scalar], 0);
        assert!(contact_sheet(&[empty], "t").is_err());
    }

    #[test]
    fn motions_of_different_layouts_are_refused() {
        let two = [motion(&[GroupKind::Scalar], 3), motion(&[GroupKind::Position], 3)];
        let error = contact_sheet(&two, "t").unwrap_err().to_string();
        assert!(error.contains("motion 1"), "{error}");
    }

    #[test]
    fn servos_get_one_panel_a_channel_and_one_curve_a_motion() {
        let kinds = [GroupKind::Scalar, GroupKind::Rotation6d];
        let motions = [motion(&kinds, 20), motion(&kinds, 30)];
        let sheet = contact_sheet(&motions, "t").unwrap();
        assert!(sheet.contains("g0 (m)") && sheet.contains("g1 turn about z (deg)"));
        assert_eq!(sheet.matches(r#"stroke-width="1.5""#).count(), 4 * 2);
        assert!(sheet.contains("wave &amp; &lt;bow&gt;"));
    }

    #[test]
    fn body_gets_ten_figures_with_every_bone() {
        let mut body = motion(&[GroupKind::Position; 24], 60);
        body.skeleton = Some(Skeleton::smpl24());
        let sheet = contact_sheet(&[body], "t").unwrap();
        assert_eq!(sheet.matches(r#"stroke-width="2.6""#).count(), 10 * 23);
    }

    #[test]
    fn body_of_one_pose_or_without_a_tree_is_drawn_too() {
        for frame_count in [1, 2, 11] {
            let sheet = contact_sheet(&[motion(&[GroupKind::Position; 5], frame_count)], "t");
            assert!(!sheet.unwrap().contains("NaN"));
        }
    }
}
