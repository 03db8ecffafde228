//! The networks that benchmarks count: their shapes, as the trainer's presets have them.
//!
//! Why here: this crate does not know the trainer, so the few numbers that counts depend on stand here once more.
//! Source: `host-trainer/presets/*.toml`; Cervantes et al., ECCV 2022, section 4.2, for `paper`.

use karakuri::GroupKind;

/// A network to be counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Network {
    /// The paper's: codes 128 + 128, 256 sinusoids, layers 1000, 500, 500, 200, 100, a body of 24 joints.
    Paper,
    /// Preset `small` with the built-in character's 11 servos.
    Small,
    /// Preset `tiny` with the built-in character's 11 servos.
    Tiny,
}

/// Everything that a network's counts depend on.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// Numbers of β and of α.
    pub code_counts: [u16; 2],
    /// Frequencies of the time embedding.
    pub frequency_count: u16,
    /// One frequency over the one before it.
    pub frequency_ratio: f64,
    /// Outputs of every layer but the last.
    pub hidden_widths: &'static [u16],
    /// Groups of channels and how many there are of each kind.
    pub groups: &'static [(GroupKind, usize)],
}

impl Network {
    /// The name in commands and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Small => "small",
            Self::Tiny => "tiny",
        }
    }

    /// Its shape.
    pub const fn shape(self) -> Shape {
        const SERVOS: &[(GroupKind, usize)] = &[(GroupKind::Scalar, 11)];
        // Ratios: base^(-2 / sinusoids), with the presets' bases 10,000 and 300.
        match self {
            Self::Paper => Shape {
                code_counts: [128, 128],
                frequency_count: 128,
                frequency_ratio: 0.930_572,
                hidden_widths: &[1000, 500, 500, 200, 100],
                groups: &[(GroupKind::Translation, 1), (GroupKind::Rotation6d, 24)],
            },
            Self::Small => Shape {
                code_counts: [32, 32],
                frequency_count: 32,
                frequency_ratio: 0.836_738,
                hidden_widths: &[256, 256, 128],
                groups: SERVOS,
            },
            Self::Tiny => Shape {
                code_counts: [16, 16],
                frequency_count: 32,
                frequency_ratio: 0.836_738,
                hidden_widths: &[96, 96, 64],
                groups: SERVOS,
            },
        }
    }
}

impl Shape {
    /// Outputs of the last layer.
    pub fn channel_count(&self) -> u16 {
        self.groups.iter().map(|(kind, count)| (kind.channel_count() * count) as u16).sum()
    }

    /// (inputs, outputs) of code half, time half and every further layer.
    pub fn layers(&self) -> Vec<(u16, u16)> {
        let first = self.hidden_widths[0];
        let mut layers =
            vec![(self.code_counts.iter().sum(), first), (2 * self.frequency_count, first)];
        let inputs = self.hidden_widths.iter().copied();
        let outputs = inputs.clone().skip(1).chain([self.channel_count()]);
        layers.extend(inputs.zip(outputs));
        layers
    }
}

#[cfg(test)]
mod tests {
    use super::Network;

    #[test]
    fn paper_has_the_papers_work_per_pose() {
        let layers = Network::Paper.shape().layers();
        let work: u64 =
            layers.iter().map(|&(inputs, outputs)| u64::from(inputs) * u64::from(outputs)).sum();
        assert_eq!(work, 1_396_700);
        assert_eq!(Network::Paper.shape().channel_count(), 147);
    }
}
