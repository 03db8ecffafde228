//! Small bodies that move, for tests.

use crate::clip::{Clip, ClipSet};
use crate::layout::{Group, GroupKind, PoseLayout, Unit};

/// Swings of three joints in positions: so many clips of each named action, of about this many frames.
pub fn clip_set(counts: &[(&str, usize)], frame_count: usize) -> ClipSet {
    let joint =
        |name: &str| Group { name: name.to_owned(), kind: GroupKind::Position, unit: Unit::Metre };
    let clips = counts.iter().enumerate().flat_map(|(index, &(action, count))| {
        (0..count).map(move |number| Clip {
            name: format!("{action}{number:03}"),
            action: action.to_owned(),
            source: "memory".into(),
            poses: swing(index, number, frame_count + number % 7),
        })
    });
    let mut clips: Vec<Clip> = clips.collect();
    clips.sort_by(|a, b| a.name.cmp(&b.name));
    ClipSet {
        layout: PoseLayout { groups: ["hip", "knee", "toe"].map(joint).to_vec() },
        rate_hz: 20.0,
        skeleton: None,
        clips,
        remarks: Vec::new(),
    }
}

fn swing(action: usize, number: usize, frame_count: usize) -> Vec<f32> {
    let pose = |frame: usize| {
        let phase = (0.1 + 0.07 * action as f32) * frame as f32 + 0.9 * number as f32;
        let (sine, cosine) = phase.sin_cos();
        let walk = 0.01 * frame as f32;
        [[walk, 0.0, 0.0], [walk + sine, cosine, 0.0], [walk + sine, cosine, 0.5]].concat()
    };
    (0..frame_count).flat_map(pose).collect()
}
