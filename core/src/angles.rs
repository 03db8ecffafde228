//! A joint's rotation as three angles, for parts with an FPU that drive one servo per axis.
//!
//! In:  the six channels of a `Rotation6d` group.
//! Out: yaw, pitch and roll.
//!
//! Why here: micromath's square root and arc tangent take some 30 instructions where libm's take hundreds, and their
//! error is below the 0.44° that one step of a 12-bit servo driver at 50 Hz makes.
//! Source: Zhou et al., CVPR 2019, for the Gram–Schmidt step; rotations are Rz(yaw) · Ry(pitch) · Rx(roll).

use micromath::F32Ext;

/// Angles of a rotation Rz(yaw) · Ry(pitch) · Rx(roll), radians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Angles {
    /// About z, −π..=π.
    pub yaw_rad: f32,
    /// About y, −π/2..=π/2.
    pub pitch_rad: f32,
    /// About x, −π..=π.
    pub roll_rad: f32,
}

/// Angles of the rotation whose matrix has these first two rows, Q15.16, orthonormal or not.
///
/// # Accuracy
/// Against f64 for pitches within ±80°: 0.3° max, 0.12° RMS (asserted by `angles_error_over_all_rotations`).
/// Within 10° of straight up or down yaw and roll turn about the same axis and only their sum is meaningful.
pub fn angles_from_rotation6d(channels: [i32; 6]) -> Angles {
    let [a0, a1, a2, b0, b1, b2] = channels.map(|channel| channel as f32 / 65_536.0);
    let first = normalize([a0, a1, a2], [1.0, 0.0, 0.0]);
    let along = dot(first, [b0, b1, b2]);
    let [f0, f1, f2] = first;
    let second = normalize([b0 - along * f0, b1 - along * f1, b2 - along * f2], [0.0, 1.0, 0.0]);
    let [s0, s1, s2] = second;
    // Third row = first × second; the first column of the matrix holds yaw and pitch.
    let third_0 = f1 * s2 - f2 * s1;
    let third_1 = f2 * s0 - f0 * s2;
    let third_2 = f0 * s1 - f1 * s0;
    Angles {
        yaw_rad: arc_tangent(s0, f0),
        pitch_rad: arc_tangent(-third_0, square_root(f0 * f0 + s0 * s0)),
        roll_rad: arc_tangent(third_1, third_2),
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The angle of the point (x, y); 0 at the origin, where micromath gives no number.
fn arc_tangent(y: f32, x: f32) -> f32 {
    if x == 0.0 && y == 0.0 { 0.0 } else { F32Ext::atan2(y, x) }
}

/// `v / |v|`, or `fallback` when `v` is zero.
fn normalize(v: [f32; 3], fallback: [f32; 3]) -> [f32; 3] {
    let length = square_root(dot(v, v));
    if length > 0.0 { v.map(|x| x / length) } else { fallback }
}

/// micromath's estimate is good to a few percent; one Newton step brings it below 0.1 %.
fn square_root(square: f32) -> f32 {
    if square <= 0.0 {
        return 0.0;
    }
    // Named in full: where std is linked, its own `sqrt` would win.
    let estimate = F32Ext::sqrt(square);
    0.5 * (estimate + square / estimate)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degenerate_rotations_give_finite_angles() {
        let angles = angles_from_rotation6d([0; 6]);
        assert!(
            angles.yaw_rad.is_finite()
                && angles.pitch_rad.is_finite()
                && angles.roll_rad.is_finite()
        );
    }

    #[test]
    fn angles_error_over_all_rotations() {
        let (mut worst, mut sum, mut count) = (0.0f64, 0.0f64, 0.0f64);
        for yaw in (-175..=175).step_by(10) {
            for pitch in (-80..=80).step_by(5) {
                for roll in (-175..=175).step_by(10) {
                    let wanted = [yaw, pitch, roll].map(|angle| f64::from(angle).to_radians());
                    let got = angles_from_rotation6d(rows_of(wanted));
                    for (wanted, got) in
                        wanted.into_iter().zip([got.yaw_rad, got.pitch_rad, got.roll_rad])
                    {
                        let error = (f64::from(got) - wanted).to_degrees().abs();
                        worst = worst.max(error);
                        sum += error * error;
                        count += 1.0;
                    }
                }
            }
        }
        let rms = libm::sqrt(sum / count);
        assert!(worst <= 0.3, "max {worst} deg");
        assert!(rms <= 0.12, "RMS {rms} deg");
    }

    fn rows_of([yaw, pitch, roll]: [f64; 3]) -> [i32; 6] {
        let (sy, cy, sp, cp) = (libm::sin(yaw), libm::cos(yaw), libm::sin(pitch), libm::cos(pitch));
        let (sr, cr) = (libm::sin(roll), libm::cos(roll));
        let rows = [
            cy * cp,
            cy * sp * sr - sy * cr,
            cy * sp * cr + sy * sr,
            sy * cp,
            sy * sp * sr + cy * cr,
            sy * sp * cr - cy * sr,
        ];
        rows.map(|value| libm::round(value * 65_536.0) as i32)
    }
}
