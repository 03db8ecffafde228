//! Station 3: the decoder in f32, as trained.
//!
//! pose(t) = D(β, α, τ(t)): layer 1 sees [β, α, τ(t)], every hidden layer is Linear + ELU, the last is Linear.
//!
//! In:  [`ModelShape`] from the configuration, then gradients from `train`.
//! Out: standardised poses; the layers themselves to `checkpoint` and `quantize`.
//!
//! Why here: forward and backward pass live in `float_model/`, one file each, over one [`Workspace`] of buffers that
//! are allocated once.
//!
//! Source: Cervantes et al., ECCV 2022, section 3; published code for the order [β, α, τ].

pub mod activation;
pub mod backward;
pub mod forward;
pub mod modulation;
pub mod tied_codes;
pub mod workspace;

use rand::{Rng, RngExt};

pub use backward::Wanted;
pub use forward::Rows;
pub use modulation::Modulation;
pub use workspace::Workspace;

/// One fully connected layer: `output = weights · input + bias`.
#[derive(Clone, Debug, PartialEq)]
pub struct DenseLayer {
    /// Number of inputs.
    pub input_count: usize,
    /// Number of outputs.
    pub output_count: usize,
    /// Row-major. // (out, in)
    pub weights: Vec<f32>,
    /// One a row. // (out)
    pub bias: Vec<f32>,
}

/// All layers, first to last; ELU between them.
#[derive(Clone, Debug, PartialEq)]
pub struct FloatModel {
    /// Numbers of inputs of layer 1, in order: sequence code β, action code α, sinusoids τ.
    pub sequence_code_count: usize,
    /// See `sequence_code_count`.
    pub action_code_count: usize,
    /// Angular frequency of each sinusoid pair, radians per frame; τ = [sin(w_0 t), cos(w_0 t), sin(w_1 t), …]. //
    /// (pair)
    pub frequencies_rad: Vec<f64>,
    /// The layers.
    pub layers: Vec<DenseLayer>,
    /// Gates of all hidden units, layer after layer, then phases of the frequencies; see [`modulation`]. // (row, β
    /// then α)
    pub modulation: Option<DenseLayer>,
}

/// A Gaussian a row: the learned codes of all clips, or of all actions.
#[derive(Clone, Debug, PartialEq)]
pub struct CodeTable {
    /// Numbers per code.
    pub dimension_count: usize,
    /// // (row, dimension)
    pub mean: Vec<f32>,
    /// Natural logarithm of the variance. // (row, dimension)
    pub log_variance: Vec<f32>,
}

/// The numbers that fix every shape of a [`FloatModel`].
#[derive(Clone, Debug, PartialEq)]
pub struct ModelShape<'a> {
    /// Dimensions of β.
    pub sequence_code_count: usize,
    /// Dimensions of α.
    pub action_code_count: usize,
    /// Dimensions of τ; even.
    pub sinusoid_count: usize,
    /// Base of the geometric series of frequencies.
    pub frequency_base: f64,
    /// Outputs of every hidden layer; at least one.
    pub hidden_widths: &'a [usize],
    /// Channels of a pose.
    pub channel_count: usize,
    /// What besides layer 1 follows the code.
    pub modulation: Modulation,
}

impl ModelShape<'_> {
    /// Inputs of layer 1, then the outputs of every layer.
    pub fn widths(&self) -> Vec<usize> {
        let input_count = self.sequence_code_count + self.action_code_count + self.sinusoid_count;
        [&[input_count], self.hidden_widths, &[self.channel_count]].concat()
    }
}

impl DenseLayer {
    /// A layer of zeros.
    pub fn zeros(input_count: usize, output_count: usize) -> Self {
        Self {
            input_count,
            output_count,
            weights: vec![0.0; input_count * output_count],
            bias: vec![0.0; output_count],
        }
    }

    /// A layer of the same shape, all zeros: its gradient, or a moment of it.
    pub fn zeros_like(&self) -> Self {
        Self::zeros(self.input_count, self.output_count)
    }

    /// Weights and bias uniform in ±1/√in: PyTorch's default, which the published code uses.
    fn random(input_count: usize, output_count: usize, rng: &mut impl Rng) -> Self {
        Self::uniform(input_count, output_count, input_count, rng)
    }

    /// Weights and bias uniform in ±1/√`fan`.
    pub(crate) fn uniform(
        input_count: usize,
        output_count: usize,
        fan: usize,
        rng: &mut impl Rng,
    ) -> Self {
        let limit = 1.0 / (fan as f32).sqrt();
        let mut layer = Self::zeros(input_count, output_count);
        for value in layer.weights.iter_mut().chain(&mut layer.bias) {
            *value = rng.random_range(-limit..limit);
        }
        layer
    }
}

impl CodeTable {
    /// Standard start: every mean 0, every log-variance the same constant.
    pub fn constant(row_count: usize, dimension_count: usize, log_variance: f32) -> Self {
        Self {
            dimension_count,
            mean: vec![0.0; row_count * dimension_count],
            log_variance: vec![log_variance; row_count * dimension_count],
        }
    }

    /// A table of the same shape, all zeros.
    pub fn zeros_like(&self) -> Self {
        Self::constant(self.row_count(), self.dimension_count, 0.0)
    }

    /// Number of codes.
    pub fn row_count(&self) -> usize {
        self.mean.len() / self.dimension_count.max(1)
    }

    /// Mean of one code. // (dimension)
    pub fn mean_of(&self, row: usize) -> &[f32] {
        &self.mean[row * self.dimension_count..][..self.dimension_count]
    }

    /// Log-variance of one code. // (dimension)
    pub fn log_variance_of(&self, row: usize) -> &[f32] {
        &self.log_variance[row * self.dimension_count..][..self.dimension_count]
    }
}

impl FloatModel {
    /// A model with random weights, ready to be trained.
    pub fn random(shape: &ModelShape<'_>, rng: &mut impl Rng) -> Self {
        Self {
            sequence_code_count: shape.sequence_code_count,
            action_code_count: shape.action_code_count,
            frequencies_rad: frequencies_rad(shape.sinusoid_count, shape.frequency_base),
            layers: shape
                .widths()
                .windows(2)
                .map(|pair| DenseLayer::random(pair[0], pair[1], rng))
                .collect(),
            modulation: shape.random_modulation(rng),
        }
    }

    /// Numbers of β and α together: the inputs of layer 1 that are constant over a motion.
    pub fn code_count(&self) -> usize {
        self.sequence_code_count + self.action_code_count
    }

    /// Numbers of τ.
    pub fn sinusoid_count(&self) -> usize {
        2 * self.frequencies_rad.len()
    }

    /// Channels of a pose.
    pub fn channel_count(&self) -> usize {
        self.layers.last().map_or(0, |layer| layer.output_count)
    }

    /// Weights and biases together.
    pub fn parameter_count(&self) -> usize {
        let layer_count = |layer: &DenseLayer| layer.weights.len() + layer.bias.len();
        self.trained_layers().map(layer_count).sum()
    }

    /// Writes τ(t): `[sin(w_0 t), cos(w_0 t), sin(w_1 t), …]`, in f64 inside.
    ///
    /// # Shapes
    /// `tau` (2 · pair)
    pub fn embed_time(&self, time_frames: f64, tau: &mut [f32]) {
        for (pair, frequency_rad) in tau.chunks_exact_mut(2).zip(&self.frequencies_rad) {
            let (sine, cosine) = (frequency_rad * time_frames).sin_cos();
            pair.copy_from_slice(&[sine as f32, cosine as f32]);
        }
    }

    /// Decodes one standardised pose.
    ///
    /// # Shapes
    /// `code` (β then α) · `pose` (channel)
    ///
    /// # Cost
    /// Allocates; a whole motion is cheaper through [`FloatModel::decode_motion`].
    pub fn decode(&self, code: &[f32], time_frames: f64, pose: &mut [f32]) {
        self.decode_motion(code, &[time_frames], pose);
    }

    /// Decodes the standardised poses of one code at many times.
    ///
    /// # Shapes
    /// `code` (β then α) · `times_frames` (row) · `poses` (row, channel)
    pub fn decode_motion(&self, code: &[f32], times_frames: &[f64], poses: &mut [f32]) {
        let mut tau = vec![0.0; times_frames.len() * self.sinusoid_count()];
        for (row, &time_frames) in tau.chunks_exact_mut(self.sinusoid_count()).zip(times_frames) {
            self.embed_time(time_frames, row);
        }
        let rows = Rows {
            codes: code,
            tau: &tau,
            code_of_row: &vec![0; times_frames.len()],
            moment_of_row: &Vec::from_iter(0..times_frames.len()),
        };
        let mut workspace = Workspace::new(self, 1, times_frames.len(), times_frames.len());
        self.forward(&rows, &mut workspace);
        for (pose, output) in poses.chunks_exact_mut(self.channel_count()).zip(workspace.outputs())
        {
            pose.copy_from_slice(output);
        }
    }
}

/// Angular frequency of every sinusoid pair k: `base^(-2k / sinusoid_count)` radians per frame.
///
/// # Source
/// Vaswani et al. 2017 with base 10000; published code, with 256 sinusoids.
fn frequencies_rad(sinusoid_count: usize, base: f64) -> Vec<f64> {
    (0..sinusoid_count / 2)
        .map(|pair| base.powf(-2.0 * pair as f64 / sinusoid_count as f64))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    fn paper_model() -> FloatModel {
        let shape = ModelShape {
            sequence_code_count: 128,
            action_code_count: 128,
            sinusoid_count: 256,
            frequency_base: 10000.0,
            hidden_widths: &[1000, 500, 500, 200, 100],
            channel_count: 147,
            modulation: Modulation::None,
        };
        FloatModel::random(&shape, &mut ChaCha8Rng::seed_from_u64(1))
    }

    #[test]
    fn paper_size_has_the_paper_parameter_count() {
        assert_eq!(paper_model().parameter_count(), 1_399_147);
    }

    #[test]
    fn start_weights_stay_inside_one_over_root_fan_in() {
        for layer in paper_model().layers {
            let limit = 1.0 / (layer.input_count as f32).sqrt();
            let largest = layer.weights.iter().fold(0.0_f32, |max, w| max.max(w.abs()));
            assert!(largest <= limit && largest > 0.99 * limit);
        }
    }

    #[test]
    fn time_embedding_interleaves_sine_and_cosine() {
        let model = paper_model();
        let mut tau = [0.0; 256];
        model.embed_time(3.0, &mut tau);
        let frequency_rad = 10000_f64.powf(-4.0 / 256.0);
        assert_eq!(tau[0], 3_f64.sin() as f32);
        assert_eq!(tau[1], 3_f64.cos() as f32);
        assert_eq!(tau[4], (3.0 * frequency_rad).sin() as f32);
    }

    #[test]
    fn one_pose_equals_its_row_of_the_motion() {
        let model = paper_model();
        let code = vec![0.3; 256];
        let (mut one, mut many) = (vec![0.0; 147], vec![0.0; 3 * 147]);
        model.decode(&code, 1.5, &mut one);
        model.decode_motion(&code, &[0.0, 1.5, 7.0], &mut many);
        for (a, b) in one.iter().zip(&many[147..294]) {
            assert!((a - b).abs() < 1e-5);
        }
    }
}
