//! `host-trainer train`.
