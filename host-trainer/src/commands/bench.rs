//! `host-trainer bench`.
