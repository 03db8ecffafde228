//! Motions as `trajectory_msgs/msg/JointTrajectory` of ROS 2, in YAML.
//!
//! In:  a [`Motion`] with scalar channels.
//! Out: text that `ros2 topic pub --once … "$(cat FILE)"` and every YAML reader takes.
//!
//! Angles are in radians, lengths in metres. Positions and velocities are given, so controllers interpolate with
//! cubics and velocity has no steps; the last velocity is 0, which controllers demand. The first point is not at time
//! 0 but [`LEAD_IN_S`] later: the controller needs that time to come from wherever the robot stands.
//!
//! Source: ROS 2 message definition; documentation of ros2_controllers' joint_trajectory_controller.

use std::fmt::Write;

use crate::bake::credit;
use crate::error::{Error, Result};
use crate::export::Motion;
use crate::layout::{Group, GroupKind, Unit};

/// Time for the way to the first pose, s.
pub const LEAD_IN_S: f64 = 1.0;

/// The whole file; channels that are no joints are left out with a remark.
///
/// # Errors
/// No channel is a scalar angle, length or number.
pub fn emit(motion: &Motion, remarks: &mut Vec<String>) -> Result<Vec<u8>> {
    let mut joints = Vec::new();
    let mut left_out = Vec::new();
    for (group, range) in motion.layout.ranges() {
        match si_per_unit(group) {
            Some(factor) => joints.push((group.name.as_str(), range.start, factor)),
            None => left_out.push(group.name.as_str()),
        }
    }
    if joints.is_empty() {
        let expected = "scalars in rad, deg, m, cm, mm or one";
        let remedy = "bake csv or bvh";
        return Err(Error::bad_input("--format", "joints of the model", "none", expected, remedy));
    }
    if !left_out.is_empty() {
        remarks
            .push(format!("left out, because they are no joints of ROS: {}", left_out.join(", ")));
    }
    let positions: Vec<Vec<f64>> = motion
        .frames()
        .map(|pose| {
            joints.iter().map(|(_, channel, factor)| f64::from(pose[*channel]) * factor).collect()
        })
        .collect();
    Ok(text(motion, &joints.iter().map(|joint| joint.0).collect::<Vec<_>>(), &positions)
        .into_bytes())
}

fn text(motion: &Motion, names: &[&str], positions: &[Vec<f64>]) -> String {
    // A JSON string is a YAML string.
    let names: Vec<String> =
        names.iter().map(|name| serde_json::Value::from(*name).to_string()).collect();
    let mut text = format!(
        "# {}\nheader:\n  stamp: {{sec: 0, nanosec: 0}}\n  frame_id: \"\"\njoint_names: [{}]\npoints:\n",
        credit(motion),
        names.join(", ")
    );
    for frame in 0..positions.len() {
        let list = |values: Vec<f64>| {
            values.iter().map(|value| format!("{value:.7}")).collect::<Vec<_>>().join(", ")
        };
        let time_ns = ((LEAD_IN_S + frame as f64 / motion.rate_hz) * 1e9).round() as u64;
        let (sec, nanosec) = (time_ns / 1_000_000_000, time_ns % 1_000_000_000);
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "- positions: [{}]\n  velocities: [{}]\n  time_from_start: {{sec: {sec}, nanosec: {nanosec}}}",
            list(positions[frame].clone()),
            list(velocities(positions, frame, motion.rate_hz))
        );
    }
    text
}

/// Central differences, one-sided at the start; 0 at the end. // (joint)
fn velocities(positions: &[Vec<f64>], frame: usize, rate_hz: f64) -> Vec<f64> {
    let Some(after) = positions.get(frame + 1) else {
        return vec![0.0; positions[frame].len()];
    };
    let before = &positions[frame.saturating_sub(1)];
    let span_s = if frame == 0 { 1.0 } else { 2.0 } / rate_hz;
    after.iter().zip(before).map(|(after, before)| (after - before) / span_s).collect()
}

fn si_per_unit(group: &Group) -> Option<f64> {
    if group.kind != GroupKind::Scalar {
        return None;
    }
    match group.unit {
        Unit::One | Unit::Radian | Unit::Metre => Some(1.0),
        Unit::Degree => Some(1f64.to_radians()),
        Unit::Centimetre => Some(0.01),
        Unit::Millimetre => Some(0.001),
        Unit::Microsecond => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::specimen;

    struct Point {
        positions: Vec<f64>,
        velocities: Vec<f64>,
        time_s: f64,
    }

    /// A strict reader of the layout that `emit` writes.
    fn read(text: &str) -> (Vec<String>, Vec<Point>) {
        let mut lines = text.lines();
        assert!(lines.next().unwrap().starts_with("# karakuri"));
        let head: Vec<&str> = lines.by_ref().take(3).collect();
        assert_eq!(head, ["header:", "  stamp: {sec: 0, nanosec: 0}", "  frame_id: \"\""]);
        let names =
            serde_json::from_str(lines.next().unwrap().strip_prefix("joint_names: ").unwrap())
                .unwrap();
        assert_eq!(lines.next(), Some("points:"));
        let lines: Vec<&str> = lines.collect();
        let point = |lines: &[&str]| {
            let list =
                |line: &str, key| serde_json::from_str(line.strip_prefix(key).unwrap()).unwrap();
            let time = lines[2]
                .strip_prefix("  time_from_start: {sec: ")
                .unwrap()
                .strip_suffix('}')
                .unwrap();
            let (sec, nanosec) = time.split_once(", nanosec: ").unwrap();
            let nanosec: u32 = nanosec.parse().unwrap();
            assert!(nanosec < 1_000_000_000);
            Point {
                positions: list(lines[0], "- positions: "),
                velocities: list(lines[1], "  velocities: "),
                time_s: f64::from(sec.parse::<u32>().unwrap()) + f64::from(nanosec) * 1e-9,
            }
        };
        (names, lines.chunks_exact(3).map(point).collect())
    }

    #[test]
    fn model_without_joints_is_refused() {
        let mut motion = specimen::motion_of(&[0.0]);
        motion.layout.groups[0].unit = Unit::Microsecond;
        let error = emit(&motion, &mut Vec::new()).unwrap_err().to_string();
        assert!(error.contains("scalars in rad"), "{error}");
    }

    #[test]
    fn trajectories_come_back_and_end_at_rest() {
        for motion in specimen::character(4) {
            let text = String::from_utf8(emit(&motion, &mut Vec::new()).unwrap()).unwrap();
            let (names, points) = read(&text);
            assert_eq!(names.len(), motion.layout.groups.len());
            assert_eq!(points.len(), motion.frame_count());
            assert!(points[0].time_s > 0.0);
            assert!(points.last().unwrap().velocities.iter().all(|velocity| *velocity == 0.0));
            for (index, (point, pose)) in points.iter().zip(motion.frames()).enumerate() {
                assert!((point.time_s - LEAD_IN_S - index as f64 / motion.rate_hz).abs() < 1e-8);
                let pairs = point.positions.iter().zip(pose);
                assert!(
                    pairs
                        .into_iter()
                        .all(|(read, deg)| (read.to_degrees() - f64::from(*deg)).abs() < 1e-5)
                );
            }
        }
    }

    #[test]
    fn velocities_carry_the_motion_between_points() {
        // A swing of 1 Hz: cubics between the points stay on it, lines would be off by 0.05°.
        let swing = |at_s: f64| 30.0 * (std::f64::consts::TAU * at_s).sin();
        let degrees: Vec<f32> =
            (0..50).map(|frame| swing(f64::from(frame) / 25.0) as f32).collect();
        let motion = Motion { rate_hz: 25.0, ..specimen::motion_of(&degrees) };
        let text = String::from_utf8(emit(&motion, &mut Vec::new()).unwrap()).unwrap();
        let (_, points) = read(&text);
        for pair in points[1..48].windows(2) {
            let span_s = pair[1].time_s - pair[0].time_s;
            let slope = (pair[0].velocities[0] - pair[1].velocities[0]) * span_s / 8.0;
            let middle = (pair[0].positions[0] + pair[1].positions[0]) / 2.0 + slope;
            let at_s = pair[0].time_s - LEAD_IN_S + span_s / 2.0;
            assert!((middle.to_degrees() - swing(at_s)).abs() < 0.03);
        }
    }
}
