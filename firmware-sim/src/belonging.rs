//! Whether a blob was made of a checkpoint.
//!
//! In:  a [`Checkpoint`], a [`Model`].
//! Out: nothing, or an error that names the first fact in which they differ.
//!
//! Why here: figures of two different models look like any others and say nothing, so everything that both files know
//! must be equal before they are compared.

use karakuri::Model;

use crate::checkpoint::Checkpoint;
use crate::error::{Error, Result};

/// Compares actions, layout, shape and the hash of the training configuration.
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
    match facts.into_iter().find(|(_, blob, run)| blob != run) {
        None => Ok(()),
        Some((field, blob, run)) => Err(Error::bad_input(
            "blob",
            field,
            blob,
            format!("{run}, as in {}", checkpoint.path.display()),
            "compare a blob with the run that it was quantized from",
        )),
    }
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
}
