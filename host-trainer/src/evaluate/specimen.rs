//! Small bodies that move, and a classifier that has learned nothing, for tests.

use std::path::Path;

use rand::RngExt;

use crate::checkpoint::tensor_file::TensorWriter;
use crate::clip::{Clip, ClipSet};
use crate::layout::{Group, GroupKind, PoseLayout, Unit};
use crate::random::{Purpose, stream};

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

/// Writes clips as npy files with a labels.csv: columns clip, action, number.
pub fn write_clips(folder: &Path, clip_set: &ClipSet, numbers: &[(&str, &str)]) {
    std::fs::create_dir_all(folder).unwrap();
    let mut labels = "clip,action,number\n".to_owned();
    for clip in &clip_set.clips {
        let (joints, frames) = (clip_set.layout.groups.len(), clip.frame_count(&clip_set.layout));
        let text = format!(
            "{{'descr': '<f4', 'fortran_order': False, 'shape': ({frames}, {joints}, 3), }}\n"
        );
        let len_bytes = u16::try_from(text.len()).unwrap().to_le_bytes();
        let mut bytes = [b"\x93NUMPY\x01\x00", &len_bytes[..], text.as_bytes()].concat();
        bytes.extend(clip.poses.iter().flat_map(|value| value.to_le_bytes()));
        std::fs::write(folder.join(format!("{}.npy", clip.name)), bytes).unwrap();
        let number = numbers.iter().find(|(action, _)| *action == clip.action);
        let number = number.map_or("0", |(_, number)| number);
        labels += &format!("{},{},{number}\n", clip.name, clip.action);
    }
    std::fs::write(folder.join("labels.csv"), labels).unwrap();
}

/// Features of the classifier that [`write_classifier`] makes.
pub const FEATURE_COUNT: usize = 4;

/// Writes a classifier of random weights; `actions` without names leave them out of the file.
pub fn write_classifier(
    file: &Path,
    channel_count: usize,
    action_count: usize,
    names: Option<&[&str]>,
) {
    const UNITS: usize = 8;
    let mut rng = stream(1, Purpose::Weights, 0);
    let shapes: Vec<(&'static str, Vec<usize>)> = vec![
        ("recurrent.weight_ih_l0", vec![3 * UNITS, channel_count]),
        ("recurrent.bias_ih_l0", vec![3 * UNITS]),
        ("recurrent.weight_hh_l0", vec![3 * UNITS, UNITS]),
        ("recurrent.bias_hh_l0", vec![3 * UNITS]),
        ("recurrent.weight_ih_l1", vec![3 * UNITS, UNITS]),
        ("recurrent.bias_ih_l1", vec![3 * UNITS]),
        ("recurrent.weight_hh_l1", vec![3 * UNITS, UNITS]),
        ("recurrent.bias_hh_l1", vec![3 * UNITS]),
        ("linear1.weight", vec![FEATURE_COUNT, UNITS]),
        ("linear1.bias", vec![FEATURE_COUNT]),
        ("linear2.weight", vec![action_count, FEATURE_COUNT]),
        ("linear2.bias", vec![action_count]),
    ];
    let mut draw = |(name, shape): (&'static str, Vec<usize>)| {
        let count = shape.iter().product();
        let values: Vec<f32> = (0..count).map(|_| rng.random_range(-1.0..1.0)).collect();
        (name, shape, values)
    };
    let tensors: Vec<_> = shapes.into_iter().map(&mut draw).collect();
    let mut writer = TensorWriter::default();
    if let Some(names) = names {
        writer.metadata("classes", serde_json::to_string(names).unwrap());
    }
    for (name, shape, values) in &tensors {
        writer.floats((*name).to_owned(), shape.clone(), values);
    }
    writer.replace(file).unwrap();
}
