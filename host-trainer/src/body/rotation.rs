//! Rotations of three-dimensional space, in f64: matrix, 6D, quaternion, geodesic angle.
//!
//! In:  directions (from `kinematics`), 6D channels (from `represent`).
//! Out: [`Rotation`] to `kinematics`, `represent` and the error figures.
//!
//! Why here: every convention (rows, sign, order of composition) is decided once, in this file.
//! Source: Zhou et al., CVPR 2019, for 6D and its Gram-Schmidt inverse. Difference: the six numbers
//! are the first two *rows* of the matrix, row-major, as in pytorch3d; the paper takes columns.

/// A vector of three-dimensional space.
pub type Vector = [f64; 3];

/// A unit quaternion, scalar first: w, x, y, z.
pub type Quaternion = [f64; 4];

/// Below this length a vector has no direction. Far under a micrometre, far above rounding.
const LENGTH_MIN: f64 = 1e-9;

/// A proper rotation as an orthonormal matrix that acts on columns: `apply(v) = rows · v`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation {
    /// Row-major. // (row, column)
    pub rows: [Vector; 3],
}

impl Rotation {
    /// Leaves every vector as it is.
    pub const IDENTITY: Self = Self { rows: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] };

    /// Orthonormalises six numbers, the first two rows, by Gram-Schmidt.
    ///
    /// Total: rows without a direction are replaced by an arbitrary but fixed choice, so that a
    /// badly trained decoder still gives a rotation.
    pub fn from_6d(six: &[f64; 6]) -> Self {
        let first = unit([six[0], six[1], six[2]]).unwrap_or([1.0, 0.0, 0.0]);
        let second = [six[3], six[4], six[5]];
        let along = dot(first, second);
        let second =
            unit(subtract(second, scale(first, along))).unwrap_or_else(|| any_perpendicular(first));
        Self { rows: [first, second, cross(first, second)] }
    }

    /// The first two rows, row-major.
    pub fn to_6d(&self) -> [f64; 6] {
        let [first, second, _] = self.rows;
        [first[0], first[1], first[2], second[0], second[1], second[2]]
    }

    /// From a quaternion of any length but zero; zero gives the identity.
    pub fn from_quaternion(quaternion: Quaternion) -> Self {
        let length = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length < LENGTH_MIN {
            return Self::IDENTITY;
        }
        let [w, x, y, z] = quaternion.map(|element| element / length);
        Self {
            rows: [
                [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
                [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
                [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
            ],
        }
    }

    /// The unit quaternion with a scalar part that is not negative.
    ///
    /// Accurate for every angle: it divides by the largest of the four elements (Shepperd, 1978).
    pub fn quaternion(&self) -> Quaternion {
        let [[a, b, c], [d, e, f], [g, h, i]] = self.rows;
        // Each row is 4·element·(w, x, y, z) for one element; the longest row is the best
        // conditioned.
        let candidates = [
            [1.0 + a + e + i, h - f, c - g, d - b],
            [h - f, 1.0 + a - e - i, b + d, c + g],
            [c - g, b + d, 1.0 - a + e - i, f + h],
            [d - b, c + g, f + h, 1.0 - a - e + i],
        ];
        let largest = (0..4)
            .fold(0, |best, k| if candidates[k][k] > candidates[best][best] { k } else { best });
        let chosen = candidates[largest];
        let length = chosen.iter().map(|x| x * x).sum::<f64>().sqrt();
        let sign = if chosen[0] < 0.0 { -1.0 } else { 1.0 };
        chosen.map(|element| sign * element / length)
    }

    /// Turns by the length of `vector` radians about its direction (exponential map).
    pub fn from_rotation_vector(vector: Vector) -> Self {
        let angle_rad = length(vector);
        // sin(x/2)/x tends to 1/2: the branch avoids 0/0 and nothing else.
        let factor = if angle_rad < LENGTH_MIN { 0.5 } else { (angle_rad / 2.0).sin() / angle_rad };
        let [x, y, z] = scale(vector, factor);
        Self::from_quaternion([(angle_rad / 2.0).cos(), x, y, z])
    }

    /// Axis times angle in radians, angle in 0..=π (logarithm); the inverse of
    /// [`Self::from_rotation_vector`].
    pub fn rotation_vector(&self) -> Vector {
        let [w, x, y, z] = self.quaternion();
        let sine = length([x, y, z]);
        let factor = if sine < LENGTH_MIN { 2.0 } else { 2.0 * sine.atan2(w) / sine };
        scale([x, y, z], factor)
    }

    /// The smallest turn that takes the direction of `from` to the direction of `to`: a swing
    /// without twist.
    ///
    /// `None` where it is not determined: a zero vector, or opposite directions (a half turn about
    /// any perpendicular).
    pub fn between(from: Vector, to: Vector) -> Option<Self> {
        let (from, to) = (unit(from)?, unit(to)?);
        let [x, y, z] = cross(from, to);
        let w = 1.0 + dot(from, to);
        // The quaternion (1 + cos, sin·axis) has length 2·cos(angle/2), which vanishes at a half
        // turn.
        (w > LENGTH_MIN).then(|| Self::from_quaternion([w, x, y, z]))
    }

    /// The rotation back.
    pub fn inverse(&self) -> Self {
        let rows = self.rows;
        Self { rows: std::array::from_fn(|row| std::array::from_fn(|column| rows[column][row])) }
    }

    /// `other` first, then `self`: the matrix product `self · other`.
    pub fn after(&self, other: &Self) -> Self {
        let columns = other.inverse().rows;
        Self { rows: self.rows.map(|row| std::array::from_fn(|column| dot(row, columns[column]))) }
    }

    /// Rotates a vector.
    pub fn apply(&self, vector: Vector) -> Vector {
        self.rows.map(|row| dot(row, vector))
    }

    /// Geodesic angle between two rotations, radians in 0..=π.
    pub fn angle_to_rad(&self, other: &Self) -> f64 {
        length(self.inverse().after(other).rotation_vector())
    }

    /// Spherical interpolation along the shorter arc: `self` at 0, `other` at 1.
    pub fn slerp(&self, other: &Self, position: f64) -> Self {
        let way = self.inverse().after(other).rotation_vector();
        self.after(&Self::from_rotation_vector(scale(way, position)))
    }
}

/// Inner product.
pub fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Right-handed vector product.
pub fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `a + b`.
pub fn add(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|axis| a[axis] + b[axis])
}

/// `a - b`.
pub fn subtract(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|axis| a[axis] - b[axis])
}

/// `vector · factor`.
pub fn scale(vector: Vector, factor: f64) -> Vector {
    vector.map(|element| element * factor)
}

/// Euclidean length.
pub fn length(vector: Vector) -> f64 {
    dot(vector, vector).sqrt()
}

/// The direction, or `None` where the vector is too short to have one.
pub fn unit(vector: Vector) -> Option<Vector> {
    let length = length(vector);
    (length > LENGTH_MIN).then(|| scale(vector, 1.0 / length))
}

/// A unit vector at a right angle to a unit vector; fixed, but not continuous.
pub fn any_perpendicular(direction: Vector) -> Vector {
    let axis = if direction[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
    unit(cross(direction, axis)).unwrap_or([0.0, 0.0, 1.0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Rotations of every angle, those near a half turn included.
    fn any_rotation() -> impl Strategy<Value = Rotation> {
        prop::array::uniform4(-1.0..1.0f64)
            .prop_filter("a quaternion needs a length", |q| {
                q.iter().map(|x| x * x).sum::<f64>() > 1e-3
            })
            .prop_map(Rotation::from_quaternion)
    }

    fn distance(a: &Rotation, b: &Rotation) -> f64 {
        (0..9).map(|k| (a.rows[k / 3][k % 3] - b.rows[k / 3][k % 3]).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn six_zeros_still_give_a_rotation() {
        for six in [[0.0; 6], [1.0, 0.0, 0.0, 2.0, 0.0, 0.0]] {
            let rotation = Rotation::from_6d(&six);
            assert!(distance(&rotation.after(&rotation.inverse()), &Rotation::IDENTITY) < 1e-12);
        }
    }

    #[test]
    fn swing_between_opposite_or_zero_vectors_is_refused() {
        assert_eq!(Rotation::between([1.0, 0.0, 0.0], [-2.0, 0.0, 0.0]), None);
        assert_eq!(Rotation::between([0.0; 3], [1.0, 0.0, 0.0]), None);
    }

    #[test]
    fn six_numbers_are_the_first_two_rows() {
        let quarter_about_z =
            Rotation::from_rotation_vector([0.0, 0.0, std::f64::consts::FRAC_PI_2]);
        let expected = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0];
        for (element, expected) in quarter_about_z.to_6d().iter().zip(expected) {
            assert!((element - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn half_turn_survives_the_quaternion() {
        for axis in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
            let turn = Rotation::from_rotation_vector(scale(axis, std::f64::consts::PI));
            assert!(distance(&Rotation::from_quaternion(turn.quaternion()), &turn) < 1e-12);
        }
    }

    proptest! {
        #[test]
        fn gram_schmidt_is_orthonormal_for_any_six_numbers(
            six in prop::array::uniform6(-3.0..3.0f64)
        ) {
            let rotation = Rotation::from_6d(&six);
            let product = rotation.after(&rotation.inverse());
            prop_assert!(distance(&product, &Rotation::IDENTITY) < 1e-9);
            let [x, y, z] = rotation.rows;
            prop_assert!((dot(cross(x, y), z) - 1.0).abs() < 1e-9);
        }

        #[test]
        fn every_form_gives_the_rotation_back(rotation in any_rotation()) {
            prop_assert!(distance(&Rotation::from_6d(&rotation.to_6d()), &rotation) < 1e-12);
            let by_quaternion = Rotation::from_quaternion(rotation.quaternion());
            prop_assert!(distance(&by_quaternion, &rotation) < 1e-12);
            let by_vector = Rotation::from_rotation_vector(rotation.rotation_vector());
            prop_assert!(distance(&by_vector, &rotation) < 1e-9);
        }

        #[test]
        fn swing_reaches_its_target_by_the_smallest_angle(
            from in prop::array::uniform3(0.1..1.0f64), to in prop::array::uniform3(-1.0..1.0f64)
        ) {
            prop_assume!(length(to) > 0.1);
            let (from, to) = (unit(from).unwrap(), unit(to).unwrap());
            prop_assume!(dot(from, to) > -0.999);
            let swing = Rotation::between(from, to).unwrap();
            prop_assert!(length(subtract(swing.apply(from), to)) < 1e-9);
            let angle_rad = length(cross(from, to)).atan2(dot(from, to));
            prop_assert!((swing.angle_to_rad(&Rotation::IDENTITY) - angle_rad).abs() < 1e-9);
        }

        #[test]
        fn slerp_divides_the_angle(
            a in any_rotation(), b in any_rotation(), position in 0.0..1.0f64
        ) {
            let whole_rad = a.angle_to_rad(&b);
            prop_assume!(whole_rad < 3.1);
            let middle = a.slerp(&b, position);
            prop_assert!((a.angle_to_rad(&middle) - position * whole_rad).abs() < 1e-7);
            prop_assert!(distance(&a.slerp(&b, 1.0), &b) < 1e-7);
        }
    }
}
