//! Whether a blob was made of a checkpoint.
//!
//! In:  a [`Checkpoint`], a [`Model`].
//! Out: nothing, or an error that names the first fact in which they differ.
//!
//! Why here: figures of two different models look like any others and say nothing, so everything that both files know
//! must be equal before they are compared.

use karakuri::{ActionId, Model};

use crate::checkpoint::Checkpoint;
use crate::error::{BLOB, Error, Result};

/// Compares actions, layout, shape, the hash of the training configuration, and the action codes.
///
/// The codes tell checkpoints of one run apart: training moves them with every step.
///
/// # Errors
/// [`Error::BadInput`] with both values.
pub fn check_belonging(checkpoint: &Checkpoint, model: &Model<'_>) -> Result<()> {
    let dataset = &checkpoint.dataset;
    let blob_groups = model.groups().map(|group| (group.name, group.kind, group.unit));
    let run_groups =
        dataset.layout.groups.iter().map(|group| (&*group.name, group.kind, group.unit));
    let facts = [
        ("actions", model.actions().collect::<Vec<_>>().join(", "), dataset.actions.join(", ")),
        (
            "layout",
            format!("{:?}", blob_groups.collect::<Vec<_>>()),
            format!("{:?}", run_groups.collect::<Vec<_>>()),
        ),
        ("shape", blob_shape(model), run_shape(checkpoint)),
        (
            "config hash",
            hexadecimal(&model.provenance().config_hash),
            checkpoint.config_hash.clone(),
        ),
    ];
    let expected = |run: &str| format!("{run}, as in {}", checkpoint.path.display());
    let remedy = "compare a blob with the run that it was quantized from";
    if let Some((field, blob, run)) = facts.into_iter().find(|(_, blob, run)| blob != run) {
        return Err(Error::bad_input(BLOB, field, blob, expected(&run), remedy));
    }
    let distance = action_code_distance(checkpoint, model);
    if distance > ACTION_CODE_DISTANCE_MAX {
        let distance = format!("up to {distance} steps off");
        let remedy = "the run was trained further since: quantize it again";
        return Err(Error::bad_input(BLOB, "action codes", distance, expected("equal"), remedy));
    }
    Ok(())
}

/// Steps of the code format; one, because quantiser and simulator may round a tie to different sides.
const ACTION_CODE_DISTANCE_MAX: u16 = 1;

/// Largest distance of a number of an action code in the blob from the run's, in steps of the blob's code format.
fn action_code_distance(checkpoint: &Checkpoint, model: &Model<'_>) -> u16 {
    let sequence_code_count = checkpoint.sequence_codes.column_count;
    let distance = |(action, row): (u16, &[f64])| {
        let frames = *model.trained_frames(ActionId(action)).start();
        let drawn = model.sample(ActionId(action), frames, &mut || 0).unwrap_or_default();
        let zeros = std::iter::repeat_n(0.0, sequence_code_count);
        let values: Vec<f32> = zeros.chain(row.iter().map(|&value| value as f32)).collect();
        let trained = model.code_from_f32(&values);
        let pairs = drawn.values().iter().zip(trained.values()).skip(sequence_code_count);
        pairs.map(|(drawn, trained)| drawn.abs_diff(*trained)).max()
    };
    (0..).zip(checkpoint.action_codes.rows()).filter_map(distance).max().unwrap_or_default()
}

/// Numbers of β, α and sinusoids, then the outputs of every layer.
fn blob_shape(model: &Model<'_>) -> String {
    let manifest = model.manifest();
    let outputs = manifest.layers.iter().skip(1).map(|layer| usize::from(layer.output_count));
    shape(
        manifest.sequence_code_count.into(),
        manifest.action_code_count.into(),
        2 * usize::from(manifest.frequency_count),
        outputs,
    )
}

fn run_shape(checkpoint: &Checkpoint) -> String {
    shape(
        checkpoint.sequence_codes.column_count,
        checkpoint.action_codes.column_count,
        2 * checkpoint.frequencies_rad.len(),
        checkpoint.layers.iter().map(|layer| layer.bias.len()),
    )
}

fn shape(
    sequence: usize,
    action: usize,
    sinusoids: usize,
    outputs: impl Iterator<Item = usize>,
) -> String {
    let outputs: Vec<String> = outputs.map(|count| count.to_string()).collect();
    format!("{sequence}+{action}+{sinusoids} → {}", outputs.join(" → "))
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Fixture;
    use karakuri::NumberFormat;

    fn refusal(checkpoint: &Checkpoint, blob: &[u8]) -> Error {
        check_belonging(checkpoint, &Model::from_bytes(blob).unwrap()).unwrap_err()
    }

    #[test]
    fn blob_of_another_training_is_rejected() {
        let fixture = Fixture::new(1);
        let blob = fixture.blob(NumberFormat::F16);
        let mut other = Fixture::new(1);
        other.config_hash = [1; 32];
        let error = refusal(&Checkpoint::read(other.run().path()).unwrap(), &blob);
        assert_eq!(error.exit_code(), 3);
        assert!(error.to_string().contains("config hash"), "{error}");
    }

    #[test]
    fn blob_of_another_shape_is_rejected() {
        let fixture = Fixture::new(1);
        let run = fixture.run();
        let mut checkpoint = Checkpoint::read(run.path()).unwrap();
        checkpoint.layers.pop();
        let blob = fixture.blob(NumberFormat::F16);
        let error = refusal(&checkpoint, &blob);
        assert!(error.to_string().contains("shape is 3+2+8 → 24 → 16 → 12 → 10"), "{error}");
    }

    #[test]
    fn blob_of_an_earlier_step_of_the_same_run_is_rejected() {
        let fixture = Fixture::new(1);
        let run = fixture.run();
        let mut checkpoint = Checkpoint::read(run.path()).unwrap();
        checkpoint.action_codes.values[3] += 0.001;
        let error = refusal(&checkpoint, &fixture.blob(NumberFormat::W8A8)).to_string();
        assert!(
            error.contains("up to 4 steps off") && error.contains("quantize it again"),
            "{error}"
        );
    }
}
