//! The papers' rows, and when they may stand beside ours.
//!
//! In:  what a measurement was made of: data, classifier, protocol.
//! Out: the rows of the same measurement, or the reason why there are none.
//!
//! Why here: FID, accuracy and their relatives mean nothing across data or classifiers, and little across protocols. So
//! rows are shown only where all of these are the papers', and else the reason.
//!
//! Sources: Cervantes et al., ECCV 2022, Tables 1 and 3 (MotionINR; its rows of Action2Motion and ACTOR); Tevet et al.,
//! ICLR 2023, Table 3 (MDM); Lu et al., ECCV 2022, Table 1 (ODMO).

use serde::Serialize;

use crate::body::skeleton::Skeleton;

use super::protocol::{ActionShares, Protocol, Start};
use super::report::{ClassifierDescription, DataDescription};

/// One published row; `None` where the paper gives no figure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PaperRow {
    /// The method.
    pub name: &'static str,
    /// See [`Figures`](super::report::Figures), as for all of these.
    pub fid: Option<f64>,
    /// Share.
    pub accuracy: Option<f64>,
    /// Distance of features.
    pub diversity: Option<f64>,
    /// Distance of features.
    pub multimodality: Option<f64>,
    /// Distance of features.
    pub mms: Option<f64>,
    /// Percent.
    pub apd_normalized: Option<f64>,
    /// Where it stands, and what about it is not as here.
    pub note: &'static str,
}

/// SHA-256 of Action2Motion's classifier of HumanAct12, as converted to safetensors for this project.
pub(super) const HUMANACT12_CLASSIFIER: &str =
    "a8db472e62cf830e69066da38919745ac0c0f623ac0de5c8a203ded999ea7457";

/// SHA-256 of Action2Motion's classifier of 8 actions of CMU's clips, converted likewise.
const MOCAP8_CLASSIFIER: &str = "b09c23dd61ebe269eb939484a22ba8e7f93cad40d897e48e6b493010565edf82";

/// Names of the joints that a published classifier was trained on; its file does not name them.
pub(super) fn joints_of_classifier(sha256: &str) -> Option<Vec<String>> {
    match sha256 {
        HUMANACT12_CLASSIFIER => Some(Skeleton::smpl24().names),
        MOCAP8_CLASSIFIER => Some(Skeleton::cmu20().names),
        _ => None,
    }
}

/// Clips of HumanAct12: all, and those that the papers use.
const HUMANACT12_CLIPS: [usize; 2] = [1191, 1190];

const HUMANACT12_ACTIONS: [&str; 12] = [
    "boxing",
    "drink",
    "eat",
    "jump",
    "lift_dumbbell",
    "phone",
    "run",
    "sit",
    "throw",
    "turn steering wheel",
    "walk",
    "warm_up",
];

const CMU_ACTIONS: [&str; 7] = ["Animal Behavior", "Climb", "Dance", "Jump", "Run", "Step", "Walk"];

const fn row(name: &'static str, figures: [f64; 5], note: &'static str) -> PaperRow {
    let [fid, accuracy, diversity, multimodality, mms] = figures;
    PaperRow {
        name,
        fid: Some(fid),
        accuracy: Some(accuracy),
        diversity: Some(diversity),
        multimodality: Some(multimodality),
        mms: if mms.is_nan() { None } else { Some(mms) },
        apd_normalized: None,
        note,
    }
}

const MOTION_INR: [PaperRow; 6] = [
    row("real (MotionINR)", [0.020, 0.997, 6.850, 2.450, 0.329], "MotionINR, Table 1"),
    row("Action2Motion", [0.338, 0.917, 6.879, 2.511, 0.945], "MotionINR, Tables 1 and 3"),
    row(
        "ACTOR",
        [0.12, 0.955, 6.84, 2.53, 0.921],
        "MotionINR, Tables 1 and 3; 60 frames only, real and generated joints through SMPL",
    ),
    row("MotionINR MLP", [0.114, 0.970, 6.786, 2.507, 0.941], "Tables 1 and 3; one set of draws"),
    row(
        "MotionINR Transf.",
        [0.088, 0.973, 6.881, 2.569, 0.778],
        "Tables 1 and 3; one set of draws",
    ),
    row(
        "MDM",
        [0.080, 0.990, 6.810, 2.580, f64::NAN],
        "MDM, Table 3, best row; checkpoint chosen by FID, 1000 motions, random hidden start",
    ),
];

const ODMO_HUMANACT12: PaperRow = PaperRow {
    apd_normalized: Some(96.88),
    ..row(
        "ODMO",
        [0.12, 0.9781, 7.05, 2.57, f64::NAN],
        "ODMO, Table 1; 10 repetitions, one balanced real set",
    )
};

/// Of figures that need a classifier ODMO's were measured with its own, of 7 actions, which is not published.
const ODMO_CMU: PaperRow = PaperRow {
    name: "ODMO",
    fid: None,
    accuracy: None,
    diversity: None,
    multimodality: None,
    mms: None,
    apd_normalized: Some(88.13),
    note: "ODMO, Table 1; its FID 0.34 and accuracy 93.51 % are by a classifier that is not published",
};

/// The rows that were measured as this one, or why there are none.
pub fn comparable(
    data: &DataDescription,
    classifier: &ClassifierDescription,
    protocol: &Protocol,
) -> Result<Vec<PaperRow>, String> {
    let is = |actions: &[&str], joint_count: usize| {
        data.actions.iter().eq(actions) && data.joint_count == joint_count
    };
    let rows = if is(&HUMANACT12_ACTIONS, 24) {
        rows_of_humanact12(data, classifier, protocol)
    } else if is(&CMU_ACTIONS, 20) {
        rows_of_cmu(protocol)
    } else {
        Err("the clips are neither HumanAct12's (12 actions, 24 joints) nor CMU's (7 actions, 20 joints)".to_owned())
    };
    match data.held_out_clip_count {
        0 => rows,
        count => Err(format!(
            "{count} clips were held out; the papers train on all and measure against all"
        )),
    }
}

fn rows_of_humanact12(
    data: &DataDescription,
    classifier: &ClassifierDescription,
    protocol: &Protocol,
) -> Result<Vec<PaperRow>, String> {
    let count = data.training_clip_count;
    if !HUMANACT12_CLIPS.contains(&count) {
        return Err(format!("there are {count} clips of HumanAct12's 1191"));
    }
    if classifier.sha256 != HUMANACT12_CLASSIFIER {
        return Err(
            "the classifier is not Action2Motion's of HumanAct12, by its SHA-256".to_owned()
        );
    }
    if protocol.frames != 60 {
        return Err(format!("{} frames are seen, the papers' classifier sees 60", protocol.frames));
    }
    match (protocol.actions, protocol.start) {
        (ActionShares::Data, Start::Zeros) => Ok(MOTION_INR.to_vec()),
        (ActionShares::Uniform { .. }, Start::Gaussian) => Ok(vec![ODMO_HUMANACT12]),
        (ActionShares::Data, Start::Gaussian) => {
            Err("MotionINR's hidden start is zeros; take --start zeros".to_owned())
        }
        (ActionShares::Uniform { .. }, Start::Zeros) => {
            Err("ODMO's hidden start is random; take --start gaussian".to_owned())
        }
    }
}

fn rows_of_cmu(protocol: &Protocol) -> Result<Vec<PaperRow>, String> {
    match (protocol.actions, protocol.frames) {
        (ActionShares::Uniform { .. }, 100) => Ok(vec![ODMO_CMU]),
        _ => Err("ODMO measures CMU by --actions uniform --frames 100".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classifier::example::Input;

    fn data(actions: &[&str], joint_count: usize, training_clip_count: usize) -> DataDescription {
        DataDescription {
            input: Input::Joints,
            training_clip_count,
            held_out_clip_count: 0,
            actions: actions.iter().map(|action| (*action).to_owned()).collect(),
            joint_count,
            rate_hz: 20.0,
        }
    }

    fn humanact12() -> DataDescription {
        data(&HUMANACT12_ACTIONS, 24, 1191)
    }

    fn classifier() -> ClassifierDescription {
        let file = "humanact12.safetensors".to_owned();
        ClassifierDescription { file, sha256: HUMANACT12_CLASSIFIER.to_owned() }
    }

    fn reason(
        data: &DataDescription,
        classifier: &ClassifierDescription,
        protocol: &Protocol,
    ) -> String {
        comparable(data, classifier, protocol).unwrap_err()
    }

    #[test]
    fn rows_of_another_measurement_are_refused_with_the_reason() {
        let usual = Protocol::default();
        let other_file = ClassifierDescription { sha256: "00".to_owned(), ..classifier() };
        let held_out = DataDescription { held_out_clip_count: 238, ..humanact12() };
        let uniform = ActionShares::Uniform { motions_per_action: 250 };
        for (data, classifier, protocol, word) in [
            (data(&["nod"], 24, 1191), classifier(), usual.clone(), "neither"),
            (data(&HUMANACT12_ACTIONS, 20, 1191), classifier(), usual.clone(), "neither"),
            (data(&HUMANACT12_ACTIONS, 24, 953), classifier(), usual.clone(), "953 clips"),
            (held_out, classifier(), usual.clone(), "238 clips were held out"),
            (humanact12(), other_file, usual.clone(), "SHA-256"),
            (humanact12(), classifier(), Protocol { frames: 100, ..usual.clone() }, "100 frames"),
            (
                humanact12(),
                classifier(),
                Protocol { start: Start::Gaussian, ..usual.clone() },
                "zeros",
            ),
            (
                humanact12(),
                classifier(),
                Protocol { actions: uniform, ..usual.clone() },
                "gaussian",
            ),
            (data(&CMU_ACTIONS, 20, 970), classifier(), usual, "--frames 100"),
        ] {
            let found = reason(&data, &classifier, &protocol);
            assert!(found.contains(word), "{word}: {found}");
        }
    }

    #[test]
    fn rows_of_the_same_measurement_are_given() {
        let names = |protocol: &Protocol| -> Vec<&str> {
            let rows = comparable(&humanact12(), &classifier(), protocol).unwrap();
            rows.iter().map(|row| row.name).collect()
        };
        let usual = Protocol::default();
        assert_eq!(names(&usual).len(), 6);
        let actions = ActionShares::Uniform { motions_per_action: 250 };
        assert_eq!(names(&Protocol { actions, start: Start::Gaussian, ..usual }), ["ODMO"]);
    }

    #[test]
    fn figures_that_a_paper_does_not_give_are_none() {
        assert!(MOTION_INR.iter().all(|row| row.mms.is_none() == (row.name == "MDM")));
    }
}
