//! What the character can do: one table, one function an action.
//!
//! In:  an [`Actor`].
//! Out: strokes in a [`Score`].
//!
//! Every action has the phases of classical animation: anticipation (the small move the other way),
//! the action itself, overshoot and settling. Its joints start one after another, and it ends where
//! it began.
//! Source: Thomas & Johnston, The Illusion of Life, 1981, chapter 3; Lasseter, SIGGRAPH 1987.

mod answers;
mod attention;
mod feelings;
mod manners;

use super::actor::Actor;
use super::dice::LABEL_BYTES_MAX;
use super::score::Score;

/// One thing the character can do.
pub struct Action {
    /// Label of its clips.
    pub label: &'static str,
    /// Writes one performance.
    pub perform: fn(&mut Score, &mut Actor),
    /// Depth of the breath under it; 0 holds the breath.
    pub breath_deg: f64,
    /// Whether blinks come on their own; otherwise the action places them.
    pub blinks: bool,
}

const fn action(
    label: &'static str,
    perform: fn(&mut Score, &mut Actor),
    breath_deg: f64,
    blinks: bool,
) -> Action {
    assert!(label.len() <= LABEL_BYTES_MAX);
    Action { label, perform, breath_deg, blinks }
}

/// Every action, sorted by label.
pub const ACTIONS: [Action; 10] = [
    action("doze", feelings::doze, 2.4, false),
    action("greet", manners::greet, 0.0, true),
    action("idle", attention::idle, 2.0, true),
    action("laugh", feelings::laugh, 0.0, false),
    action("look_around", attention::look_around, 0.8, true),
    action("nod", answers::nod, 0.5, true),
    action("pour_tea", manners::pour_tea, 0.6, true),
    action("shake", answers::shake, 0.5, true),
    action("startle", feelings::startle, 0.0, false),
    action("wonder", attention::wonder, 0.8, true),
];
