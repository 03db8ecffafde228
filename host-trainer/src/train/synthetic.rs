//! Small datasets and configurations for tests.

use std::path::Path;

use karakuri::{GroupKind, Unit};

use crate::config::TrainConfig;
use crate::dataset::{ClipDescription, Dataset, DatasetDescription};
use crate::layout::{Group, PoseLayout};

/// Five clips of two actions and six channels; lengths 3 to 40, so one is shorter than a batch's frames.
pub fn dataset() -> Dataset {
    let group = |name: &str, kind, unit| Group { name: name.into(), kind, unit };
    let groups = vec![
        group("jaw", GroupKind::Scalar, Unit::Degree),
        group("root", GroupKind::Translation, Unit::Metre),
        group("lid", GroupKind::Scalar, Unit::Radian),
        group("brow", GroupKind::Scalar, Unit::Degree),
    ];
    let frame_counts = [12, 3, 40, 21, 30];
    let clips = frame_counts.iter().enumerate().map(|(clip, &frame_count)| ClipDescription {
        name: format!("clip{clip}"),
        action: clip % 2,
        frame_count,
    });
    let wave = |clip: usize, frame: usize, channel: usize| {
        (0.2 * frame as f32 * (1.0 + 0.3 * channel as f32) + clip as f32).sin()
    };
    let poses = frame_counts.iter().enumerate().flat_map(|(clip, &frame_count)| {
        (0..frame_count * 6).map(move |index| wave(clip, index / 6, index % 6))
    });
    Dataset {
        first_rows: vec![0, 12, 15, 55, 76],
        poses: poses.collect(),
        description: DatasetDescription {
            layout: PoseLayout { groups },
            rate_hz: 50.0,
            actions: vec!["nod".into(), "wave".into()],
            clips: clips.collect(),
            held_out: Vec::new(),
            mean: vec![0.0; 6],
            scale: vec![2.0, 0.1, 0.1, 0.1, 0.5, 2.0],
            skeleton: None,
        },
    }
}

/// `tiny`, smaller still: three batches a pass, and these keys on top.
pub fn config(overrides: &str) -> TrainConfig {
    const BASE: &str = r#"
        [decoder]
        hidden_widths = [24, 16]
        [time]
        sinusoid_count = 8
        [codes]
        sequence_dimensions = 4
        action_dimensions = 3
        [batch]
        clips = 2
        sampling = "random"
        [budget]
        steps = 40
    "#;
    let mut table: toml::Table = BASE.parse().unwrap();
    for (section, keys) in overrides.parse::<toml::Table>().unwrap() {
        let keys = keys.as_table().unwrap().clone();
        let target = table.entry(section).or_insert(toml::Table::new().into());
        target.as_table_mut().unwrap().extend(keys);
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("test.toml");
    std::fs::write(&file, toml::to_string(&table).unwrap()).unwrap();
    TrainConfig::preset_with_file("tiny", Path::new(&file)).unwrap()
}
