//! Station 3: the decoder in f32, as trained.
//!
//! pose(t) = D(β, α, τ(t)): layer 1 sees [β, α, τ(t)], every hidden layer is Linear + ELU, the last is Linear.
//!
//! Source: Cervantes et al., ECCV 2022, section 3; published code for the order [β, α, τ].

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
    /// Angular frequency of each sinusoid pair, radians per frame; τ = [sin(w_0 t), cos(w_0 t), sin(w_1 t), …]. // (pair)
    pub frequencies_rad: Vec<f64>,
    /// The layers.
    pub layers: Vec<DenseLayer>,
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
