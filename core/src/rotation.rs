//! A joint's rotation, from the six channels that a decoder gives, and as the angles of servos.
//!
//! In:  the six channels of a `Rotation6d` group of a pose.
//! Out: [`Rotation`]; three angles for three servos in series, or the twist about one axis.
//!
//! Why here: integers, so every chip turns its servos by the same angle. Products stay within 32
//! bits: six channels of 16 fraction bits make a rotation good to some 0.003°, thirty times finer
//! than the microsecond in which servos are driven.
//! Source: Zhou et al., CVPR 2019 (6D), rows instead of columns as in `pose_layout.rs`. The third
//! row is the product of the first two, the second follows from it: the same as Gram–Schmidt, but
//! no difference of nearly equal numbers has to be taken where the rows are nearly parallel.

use crate::arc_tangent::heading;
use crate::unit_vector::{UNIT_FRACTION_BITS, mantissas, unit_q15};

/// 1 in Q1.15.
const ONE: i32 = 1 << UNIT_FRACTION_BITS;

/// Greatest element of the product of a unit row and a row of 15 bits at which the rows still count
/// as parallel: 0.008° to 0.05°, more than rounding makes of parallel rows.
const PARALLEL_MAX: u32 = 1 << 18;

/// An axis of the joint's own frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs, reason = "their names say it")]
pub enum Axis {
    X,
    Y,
    Z,
}

impl Axis {
    /// The axis after this one, as x, y, z, x.
    const fn next(self) -> Self {
        match self {
            Self::X => Self::Y,
            Self::Y => Self::Z,
            Self::Z => Self::X,
        }
    }
}

/// The axes of three servos in series, from the one fixed to the parent to the one that holds the
/// part: `Zyx` is yaw, pitch, roll with z up and x ahead; `Yxz` the same with y up and z ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs, reason = "their names say it")]
pub enum AxisOrder {
    Xyz,
    Yzx,
    Zxy,
    Xzy,
    Yxz,
    Zyx,
}

impl AxisOrder {
    /// Every order.
    pub const ALL: [Self; 6] = [Self::Xyz, Self::Yzx, Self::Zxy, Self::Xzy, Self::Yxz, Self::Zyx];

    /// First, second and third axis.
    pub const fn axes(self) -> [Axis; 3] {
        match self {
            Self::Xyz => [Axis::X, Axis::Y, Axis::Z],
            Self::Yzx => [Axis::Y, Axis::Z, Axis::X],
            Self::Zxy => [Axis::Z, Axis::X, Axis::Y],
            Self::Xzy => [Axis::X, Axis::Z, Axis::Y],
            Self::Yxz => [Axis::Y, Axis::X, Axis::Z],
            Self::Zyx => [Axis::Z, Axis::Y, Axis::X],
        }
    }

    /// 1 where the axes follow each other as x, y, z, x do, else −1.
    const fn handedness(self) -> i32 {
        match self {
            Self::Xyz | Self::Yzx | Self::Zxy => 1,
            Self::Xzy | Self::Yxz | Self::Zyx => -1,
        }
    }
}

/// A rotation as the matrix that turns columns, Q1.15.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rotation {
    rows: [[i32; 3]; 3],
}

impl Rotation {
    /// No turn.
    pub const IDENTITY: Self = Self { rows: [[ONE, 0, 0], [0, ONE, 0], [0, 0, ONE]] };

    /// The rotation whose first two rows the channels are, of any scale, made orthonormal: the
    /// first keeps its direction, the second turns towards a right angle in their common plane.
    ///
    /// Total. A first row of zeros is taken for (1, 0, 0). A second row that is zero or parallel to
    /// the first is taken for (0, 1, 0), or for (0, 0, 1) if the first lies along y. Six zeros are
    /// the identity.
    ///
    /// # Accuracy
    /// The angle to the rotation that f64 makes of the same channels, for rows of length 0.3 to 3:
    ///
    /// | angle between the rows | max | RMS |
    /// |---|---|---|
    /// | 20° to 160° | 0.014° | 0.0025° |
    /// | 5° to 20°, 160° to 175° | 0.05° | 0.007° |
    /// | 1° to 5° | 0.25° | 0.03° |
    /// | 0.1° to 1° | 2.5° | 0.2° |
    ///
    /// In general at most 0.006° / sin(angle between the rows), whatever their length from 0.001
    /// up: twice what the last bit of the channels makes of rows of length 0.3. Rows that differ by less
    /// than 0.05° say nothing about the turn about the first (all asserted by the tests named
    /// `rotation_error…`).
    ///
    /// # Cost
    /// 264 instructions on a Cortex-M4, 544 on an M0+.
    pub fn from_6d(channels: [i32; 6]) -> Self {
        let [a, b, c, d, e, f] = channels;
        let first = unit_q15([a, b, c]).unwrap_or([ONE, 0, 0]);
        let third = [[d, e, f], [0, 1, 0], [0, 0, 1]]
            .into_iter()
            .map(|second| cross(first, mantissas(second)))
            .find(|product| product.iter().any(|x| x.unsigned_abs() > PARALLEL_MAX))
            .and_then(unit_q15)
            .unwrap_or([0, 0, ONE]);
        let second = cross(third, first).map(to_q15);
        Self { rows: [first, second, third] }
    }

    /// The matrix, row-major, Q1.15: −32768..=32768. // (row, column)
    pub const fn rows_q15(&self) -> [[i32; 3]; 3] {
        self.rows
    }

    /// The angles of three servos in series, in the order of their axes, degrees in Q15.16; the
    /// middle one within ±90°, the others within ±180°.
    ///
    /// Where the middle angle is ±90° the outer axes coincide (gimbal lock) and only their sum or
    /// difference counts: whatever angle the first then gets, the third makes up for it.
    ///
    /// # Accuracy
    /// The rotation that the three angles make is within 0.0055° max, 0.0018° RMS of this one, in
    /// gimbal lock too (asserted by `three_angles_give_the_rotation_back_even_in_gimbal_lock`).
    /// Each angle, while the middle one is within ±80°: 0.0075° max, 0.0015° RMS (asserted by
    /// `angles_error_over_all_rotations`).
    ///
    /// # Cost
    /// 349 instructions on a Cortex-M4, 663 on an M0+, 10 % more where the order is not a constant.
    pub fn angles_deg_q16(&self, order: AxisOrder) -> [i32; 3] {
        let [i, j, k] = order.axes();
        let sign = order.handedness();
        let first = heading(self.at(k, k), -sign * self.at(j, k));
        // Turned back by the first angle, row j is (…, cos third, 0) and row k ends in cos second.
        let (cosine, sine) = (first.cosine_q15, sign * first.sine_q15);
        let second_cosine_q30 = cosine * self.at(k, k) - sine * self.at(j, k);
        let third_sine_q30 = cosine * self.at(j, i) + sine * self.at(k, i);
        let third_cosine_q30 = cosine * self.at(j, j) + sine * self.at(k, j);
        let second = heading(second_cosine_q30, sign * (self.at(i, k) << UNIT_FRACTION_BITS));
        let third = heading(third_cosine_q30, sign * third_sine_q30);
        [first, second, third].map(|heading| heading.deg_q16)
    }

    /// How far the rotation turns about one axis, degrees in Q15.16, ±180°: the angle of the one
    /// servo that comes closest to it.
    ///
    /// The rotation is this turn followed by one about an axis at a right angle (swing and twist).
    /// 0 where the swing is a half turn and the twist could be any.
    ///
    /// # Accuracy
    /// Swings up to 90°: 0.006° max, 0.0012° RMS; beyond, max 0.005° / cos²(swing/2) (asserted by
    /// `twist_error_over_all_swings`).
    ///
    /// # Cost
    /// 117 instructions on a Cortex-M4, 219 on an M0+.
    pub fn twist_deg_q16(&self, axis: Axis) -> i32 {
        let (j, k) = (axis.next(), axis.next().next());
        heading(self.at(j, j) + self.at(k, k), self.at(k, j) - self.at(j, k)).deg_q16
    }

    fn at(&self, row: Axis, column: Axis) -> i32 {
        let row = self.rows.get(row as usize);
        row.and_then(|row| row.get(column as usize)).copied().unwrap_or(0)
    }
}

/// Right-handed product; fits while |a|·|b| < 2^31.
fn cross([a, b, c]: [i32; 3], [d, e, f]: [i32; 3]) -> [i32; 3] {
    [b * f - c * e, c * d - a * f, a * e - b * d]
}

/// Q2.30 → Q1.15, to nearest.
const fn to_q15(product_q30: i32) -> i32 {
    (product_q30 + (1 << 14)) >> 15
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deviation::Deviation;
    use crate::random::Pcg32;

    type Matrix = [[f64; 3]; 3];

    const ONE_Q16: f64 = 65_536.0;

    /// Random numbers in f64 for tests.
    struct Chance(Pcg32);

    impl Chance {
        fn between(&mut self, low: f64, high: f64) -> f64 {
            low + (high - low) * f64::from(self.0.next_u32()) / 4_294_967_296.0
        }

        /// A direction, evenly over the sphere.
        fn direction(&mut self) -> [f64; 3] {
            loop {
                let v = [0; 3].map(|_| self.between(-1.0, 1.0));
                let length = length(v);
                if (0.1..1.0).contains(&length) {
                    return v.map(|x| x / length);
                }
            }
        }

        /// Two rows at an angle, each of its own length, as channels.
        fn rows(&mut self, apart_rad: f64, lengths: (f64, f64)) -> [i32; 6] {
            let [first, other] = [self.direction(), self.direction()];
            let [_, across, _] = exact_rotation([first, other]);
            let (sine, cosine) = (libm::sin(apart_rad), libm::cos(apart_rad));
            let second: [f64; 3] = core::array::from_fn(|k| cosine * first[k] + sine * across[k]);
            let scales = [(); 2].map(|()| self.between(lengths.0, lengths.1) * ONE_Q16);
            let [[a, b, c], [d, e, f]] =
                [first.map(|x| x * scales[0]), second.map(|x| x * scales[1])];
            [a, b, c, d, e, f].map(|x| libm::round(x) as i32)
        }
    }

    fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    }

    fn length(v: [f64; 3]) -> f64 {
        libm::sqrt(dot(v, v))
    }

    /// Gram–Schmidt.
    fn exact_rotation([first, second]: [[f64; 3]; 2]) -> Matrix {
        let a = first.map(|x| x / length(first));
        let along = dot(a, second);
        let rest: [f64; 3] = core::array::from_fn(|k| second[k] - along * a[k]);
        let b = rest.map(|x| x / length(rest));
        let c = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        [a, b, c]
    }

    fn exact_of_channels(channels: [i32; 6]) -> Matrix {
        let [a, b, c, d, e, f] = channels.map(f64::from);
        exact_rotation([[a, b, c], [d, e, f]])
    }

    fn product(a: Matrix, b: Matrix) -> Matrix {
        core::array::from_fn(|r| core::array::from_fn(|c| (0..3).map(|k| a[r][k] * b[k][c]).sum()))
    }

    fn turn(axis: Axis, angle_deg: f64) -> Matrix {
        let (sine, cosine) = (libm::sin(angle_deg.to_radians()), libm::cos(angle_deg.to_radians()));
        let (i, j) = (axis.next() as usize, axis.next().next() as usize);
        let mut matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        (matrix[i][i], matrix[i][j], matrix[j][i], matrix[j][j]) = (cosine, -sine, sine, cosine);
        matrix
    }

    fn turns(order: AxisOrder, angles_deg: [f64; 3]) -> Matrix {
        let [first, second, third] =
            [0, 1, 2].map(|index| turn(order.axes()[index], angles_deg[index]));
        product(product(first, second), third)
    }

    fn rounded(matrix: Matrix) -> Rotation {
        Rotation { rows: matrix.map(|row| row.map(|x| libm::round(x * 32_768.0) as i32)) }
    }

    fn matrix_of(rotation: &Rotation) -> Matrix {
        rotation.rows_q15().map(|row| row.map(|x| f64::from(x) / 32_768.0))
    }

    /// Of small angles: the Frobenius norm of the difference is √2 times the angle.
    fn angle_between_deg(a: Matrix, b: Matrix) -> f64 {
        let difference = |k: usize| a[k / 3][k % 3] - b[k / 3][k % 3];
        libm::sqrt((0..9).map(|k| difference(k) * difference(k)).sum::<f64>() / 2.0).to_degrees()
    }

    fn difference_deg(a: f64, b: f64) -> f64 {
        let turns = (a - b) / 360.0;
        (turns - libm::round(turns)) * 360.0
    }

    fn as_deg(angles_q16: [i32; 3]) -> [f64; 3] {
        angles_q16.map(|angle| f64::from(angle) / ONE_Q16)
    }

    #[test]
    fn six_zeros_are_the_identity() {
        assert_eq!(Rotation::from_6d([0; 6]), Rotation::IDENTITY);
    }

    #[test]
    fn missing_rows_are_those_of_the_identity() {
        let along_y = Rotation { rows: [[0, ONE, 0], [0, 0, ONE], [ONE, 0, 0]] };
        let about_x = Rotation { rows: [[ONE, 0, 0], [0, 0, ONE], [0, -ONE, 0]] };
        for (channels, expected) in [
            ([0, 0, 0, 0, 5, 0], Rotation::IDENTITY),
            ([0, 0, 0, 7, 0, 0], Rotation::IDENTITY),
            ([0, 0, 0, 3, 0, 65_536], about_x),
            ([9, 0, 0, 0, 0, 0], Rotation::IDENTITY),
            ([0, 1, 0, 0, 0, 0], along_y),
            ([0, 1, 0, 0, i32::MIN, 0], along_y),
        ] {
            assert_eq!(Rotation::from_6d(channels), expected, "{channels:?}");
        }
    }

    #[test]
    fn parallel_rows_count_as_one() {
        let mut chance = Chance(Pcg32::new(3));
        for _ in 0..20_000 {
            let scales = [(); 2].map(|()| chance.between(0.3, 3.0) * ONE_Q16);
            let direction = chance.direction();
            let [[a, b, c], [d, e, f]] =
                scales.map(|scale| direction.map(|x| libm::round(x * scale) as i32));
            let alone = Rotation::from_6d([a, b, c, 0, 0, 0]);
            for channels in [[a, b, c, d, e, f], [a, b, c, -d, -e, -f]] {
                assert_eq!(Rotation::from_6d(channels), alone, "{channels:?}");
            }
        }
    }

    #[test]
    fn extreme_channels_give_a_rotation() {
        let extremes = [i32::MIN, i32::MIN + 1, -1, 0, 1, i32::MAX];
        for index in 0..6u32.pow(6) {
            let channels = [0, 1, 2, 3, 4, 5].map(|k| extremes[(index / 6u32.pow(k) % 6) as usize]);
            let rotation = matrix_of(&Rotation::from_6d(channels));
            let transposed = core::array::from_fn(|r| core::array::from_fn(|c| rotation[c][r]));
            let identity = matrix_of(&Rotation::IDENTITY);
            let deviation = angle_between_deg(product(rotation, transposed), identity);
            assert!(deviation < 0.01, "{channels:?}: {deviation}");
        }
    }

    /// Errors of `count` random rotations from rows this far apart, and the same times the sine of
    /// the angle between the rows.
    fn errors_deg(apart_deg: (f64, f64), lengths: (f64, f64), count: u32) -> [Deviation; 2] {
        let mut chance = Chance(Pcg32::new(1));
        let mut errors = [Deviation::default(); 2];
        for _ in 0..count {
            let apart_rad = chance.between(apart_deg.0, apart_deg.1).to_radians();
            let channels = chance.rows(apart_rad, lengths);
            let got = matrix_of(&Rotation::from_6d(channels));
            let error_deg = angle_between_deg(got, exact_of_channels(channels));
            errors[0].add(error_deg);
            errors[1].add(error_deg * libm::sin(apart_rad));
        }
        errors
    }

    #[test]
    fn rotation_error_of_rows_20_to_160_deg_apart() {
        errors_deg((20.0, 160.0), (0.3, 3.0), 300_000)[0].assert_at_most(0.014, 0.0025);
    }

    #[test]
    fn rotation_error_of_nearly_parallel_rows() {
        errors_deg((5.0, 20.0), (0.3, 3.0), 100_000)[0].assert_at_most(0.05, 0.007);
        errors_deg((160.0, 175.0), (0.3, 3.0), 100_000)[0].assert_at_most(0.05, 0.007);
        errors_deg((1.0, 5.0), (0.3, 3.0), 100_000)[0].assert_at_most(0.25, 0.03);
        errors_deg((0.1, 1.0), (0.3, 3.0), 100_000)[0].assert_at_most(2.5, 0.2);
    }

    #[test]
    fn rotation_error_is_inverse_to_the_sine_between_the_rows() {
        for lengths in [(0.001, 0.3), (0.3, 3.0), (3.0, 100.0), (100.0, 32_000.0)] {
            for apart_deg in [(0.1, 1.0), (1.0, 20.0), (20.0, 90.0), (90.0, 179.9)] {
                let [_, scaled] = errors_deg(apart_deg, lengths, 50_000);
                assert!(scaled.max() <= 0.006, "{apart_deg:?} {lengths:?}: {scaled:?}");
            }
        }
    }

    #[test]
    fn angles_error_over_all_rotations() {
        for order in AxisOrder::ALL {
            let mut angles_deg = Deviation::default();
            for first in (-175..=180).step_by(10) {
                for second in -80..=80 {
                    for third in (-170..=180).step_by(10) {
                        let wanted_deg = [first, second, third].map(f64::from);
                        let got = rounded(turns(order, wanted_deg)).angles_deg_q16(order);
                        for (wanted_deg, got_deg) in wanted_deg.into_iter().zip(as_deg(got)) {
                            angles_deg.add(difference_deg(got_deg, wanted_deg));
                        }
                    }
                }
            }
            angles_deg.assert_at_most(0.0075, 0.0015);
        }
    }

    #[test]
    fn three_angles_give_the_rotation_back_even_in_gimbal_lock() {
        let mut chance = Chance(Pcg32::new(2));
        for order in AxisOrder::ALL {
            let (mut anywhere, mut near_lock) = (Deviation::default(), Deviation::default());
            for index in 0..100_000 {
                let [first, third] = [(); 2].map(|()| chance.between(-180.0, 180.0));
                // From 90° to 1e-5° away from the lock, and on it.
                let from_lock =
                    if index == 0 { 0.0 } else { libm::exp10(chance.between(-5.0, 1.954)) };
                let upper = turns(order, [first, 90.0 - from_lock, third]);
                let lower = turns(order, [first, from_lock - 90.0, third]);
                for exact in [upper, lower] {
                    let got = as_deg(rounded(exact).angles_deg_q16(order));
                    let error_deg = angle_between_deg(turns(order, got), exact);
                    if from_lock < 1.0 { &mut near_lock } else { &mut anywhere }.add(error_deg);
                }
            }
            anywhere.assert_at_most(0.0055, 0.0018);
            near_lock.assert_at_most(0.0055, 0.0018);
        }
    }

    /// Turns by the twist, then about an axis at a right angle to it.
    fn swing_after_twist(axis: Axis, swing_deg: f64, about_deg: f64, twist_deg: f64) -> Matrix {
        let swing = product(turn(axis, about_deg), turn(axis.next(), swing_deg));
        product(swing, turn(axis, twist_deg - about_deg))
    }

    #[test]
    fn twist_error_over_all_swings() {
        let mut chance = Chance(Pcg32::new(1));
        let (mut errors_deg, mut scaled_deg) = (Deviation::default(), Deviation::default());
        for axis in [Axis::X, Axis::Y, Axis::Z] {
            for _ in 0..100_000 {
                let [twist_deg, about_deg] = [(); 2].map(|()| chance.between(-180.0, 180.0));
                let swing_deg = chance.between(0.0, 170.0);
                let exact = swing_after_twist(axis, swing_deg, about_deg, twist_deg);
                let got_deg = f64::from(rounded(exact).twist_deg_q16(axis)) / ONE_Q16;
                let error_deg = difference_deg(got_deg, twist_deg);
                let half_cosine = libm::cos((swing_deg / 2.0).to_radians());
                scaled_deg.add(error_deg * half_cosine * half_cosine);
                if swing_deg <= 90.0 {
                    errors_deg.add(error_deg);
                }
            }
        }
        errors_deg.assert_at_most(0.006, 0.0012);
        scaled_deg.assert_at_most(0.005, 0.0012);
    }

    #[test]
    fn twist_of_a_half_turn_about_another_axis_is_zero() {
        let half_turn = Rotation { rows: [[-ONE, 0, 0], [0, ONE, 0], [0, 0, -ONE]] };
        assert_eq!(half_turn.twist_deg_q16(Axis::X), 0);
        assert_eq!(half_turn.twist_deg_q16(Axis::Y), 180 << 16);
    }
}
