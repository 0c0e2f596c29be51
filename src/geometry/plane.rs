use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// An infinite plane `normal · x = offset_m` with a unit normal.
///
/// Sign rule: the normal points to the side from which the surface was seen. In the frame of the
/// sensor that saw it `offset_m` is therefore never positive. A plane through the origin
/// (`offset_m == 0`) is seen edge-on and does not occur as an observation; where one is built by
/// hand, the normal is kept as given.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plane {
    /// Unit normal.
    pub normal: Vector3<f64>,
    /// Signed distance of the plane from the origin along the normal, in metres.
    pub offset_m: f64,
}

impl Plane {
    /// The plane through `point` with the direction of `normal`, which need not be of unit length.
    pub fn through(point: &Point3<f64>, normal: &Vector3<f64>) -> Self {
        let normal = normal.normalize();
        Self { normal, offset_m: normal.dot(&point.coords) }
    }

    /// Signed distance of `point` from the plane, positive on the side of the normal, in metres.
    pub fn distance_m(&self, point: &Point3<f64>) -> f64 {
        self.normal.dot(&point.coords) - self.offset_m
    }

    /// The same plane with its normal turned to the side of `viewpoint`.
    pub fn facing(self, viewpoint: &Point3<f64>) -> Self {
        if self.distance_m(viewpoint) < 0.0 {
            Self { normal: -self.normal, offset_m: -self.offset_m }
        } else {
            self
        }
    }

    /// The plane expressed in another frame.
    pub fn transformed(&self, target_from_source: &Isometry3<f64>) -> Self {
        let normal = target_from_source.rotation * self.normal;
        Self {
            normal,
            offset_m: self.offset_m + normal.dot(&target_from_source.translation.vector),
        }
    }

    /// The foot of the perpendicular from `point`.
    pub fn project(&self, point: &Point3<f64>) -> Point3<f64> {
        point - self.normal * self.distance_m(point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn transformed_plane_contains_the_transformed_points() {
        let plane = Plane::through(&Point3::new(1.0, 2.0, 3.0), &Vector3::new(0.3, -0.4, 0.8));
        let target_from_source = Isometry3::from_parts(
            Vector3::new(4.0, -1.0, 0.5).into(),
            UnitQuaternion::from_euler_angles(0.2, -0.7, 2.1),
        );
        let point = plane.project(&Point3::new(-2.0, 0.7, 1.1));
        let moved = plane.transformed(&target_from_source);
        assert!(moved.distance_m(&(target_from_source * point)).abs() < 1e-12);
        assert!((moved.normal.norm() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn facing_puts_the_viewpoint_on_the_positive_side() {
        let wall = Plane::through(&Point3::new(5.0, 0.0, 0.0), &Vector3::x());
        let seen = wall.facing(&Point3::origin());
        assert!(seen.normal.x < 0.0 && seen.offset_m < 0.0);
    }
}
