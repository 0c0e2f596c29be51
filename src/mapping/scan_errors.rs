use super::curved::{CurveKind, CurvedObservation};
use super::observation::Observation;
use nalgebra::{Isometry3, Point3, SMatrix, SVector, Vector3};
use serde::{Deserialize, Serialize};

/// Number of errors that all points of a scan share.
pub const COMMON: usize = 6;
/// One of each, in the order of [`ScanErrors::sigmas`].
pub type CommonErrors = SVector<f64, COMMON>;
/// How one unit of each moves something that was seen, by `N` components.
pub type CommonColumns<const N: usize> = SMatrix<f64, N, COMMON>;

/// Errors that all points of one scan share; they do not average out over a patch, so they are
/// modelled as unknowns of the scan. All are standard deviations; zero means that there is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScanErrors {
    /// Every tilt is off by the same angle, in radians: mount, zero of the servo, constant delay of
    /// a sweep at constant speed. Valid: 0 or more.
    pub tilt_offset_sigma_rad: f64,
    /// Every tilt is off by the same share of itself. Valid: 0 or more.
    pub tilt_scale_sigma: f64,
    /// Every range is off by the same length in metres. Valid: 0 or more.
    pub range_bias_sigma_m: f64,
    /// Every range is off by the same share of itself. Valid: 0 or more.
    pub range_scale_sigma: f64,
    /// The sensor sits elsewhere on the part that tilts by this in each axis, in metres: what the tilt turns of
    /// that. What is the same at all tilts moves the scan as a whole. Valid: 0 or more.
    pub mount_sigma_m: f64,
}

impl ScanErrors {
    /// Whether the scan has any error of this kind.
    pub fn any(&self) -> bool {
        self.sigmas().amax() > 0.0
    }

    /// The standard deviations: tilt offset, tilt scale, range bias, range scale, mount ahead, mount up.
    pub fn sigmas(&self) -> CommonErrors {
        CommonErrors::from([
            self.tilt_offset_sigma_rad,
            self.tilt_scale_sigma,
            self.range_bias_sigma_m,
            self.range_scale_sigma,
            self.mount_sigma_m,
            self.mount_sigma_m,
        ])
    }
}

/// The surfaces of one scan and what is known about the scan as a whole.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ScanObservations {
    /// The planes.
    pub observations: Vec<Observation>,
    /// Cylinders and spheres.
    #[serde(default)]
    pub curves: Vec<CurvedObservation>,
    /// Pose of the scan frame (the sensor at zero tilt) in the robot frame; the tilt turns about its
    /// y axis.
    pub robot_from_scan: Isometry3<f64>,
    /// Errors common to the scan.
    pub errors: ScanErrors,
    /// Where the wheels touch the ground, in the robot frame; empty where that is not known. A pose
    /// under which these points are not on the floors of the map is the less likely, see `sight.rs`.
    #[serde(default)]
    pub contacts: Vec<Point3<f64>>,
}

/// How one unit of each common error moves an observed plane: columns in the order of
/// [`ScanErrors::sigmas`], rows offset, rotation about y and about x of the observation's frame.
///
/// Each error displaces the points by a smooth field; the plane follows its component along the
/// normal, of which value and slope are taken at the centre of gravity and over the patch's extent.
pub fn common_error_jacobian(
    observation: &Observation,
    robot_from_scan: &Isometry3<f64>,
) -> CommonColumns<3> {
    let scan_from_plane = robot_from_scan.inverse() * observation.robot_from_plane;
    let normal = scan_from_plane.rotation * Vector3::z();
    let reach = |pick: fn(&nalgebra::Point2<f64>) -> f64| {
        let extent = observation.hull.iter().map(|p| pick(p).abs()).fold(0.0, f64::max);
        // The standard deviation of a uniform patch is what its fit sees of it.
        (extent / 3_f64.sqrt()).max(1e-3)
    };
    let (reach_x, reach_y) = (reach(|p| p.x), reach(|p| p.y));
    let along = |x: f64, y: f64| {
        let p = (scan_from_plane * Point3::new(x, y, 0.0)).coords;
        displacements(&p).map(|field| field.dot(&normal))
    };
    let centre = along(0.0, 0.0);
    let (right, left) = (along(reach_x, 0.0), along(-reach_x, 0.0));
    let (top, bottom) = (along(0.0, reach_y), along(0.0, -reach_y));
    CommonColumns::from_fn(|row, error| match row {
        // Mean over the patch: the value at its middle and what the curvature adds on average.
        0 => 0.5 * (right[error] + left[error] + top[error] + bottom[error]) - centre[error],
        // A rotation θ about y lowers points at +x.
        1 => -(right[error] - left[error]) / (2.0 * reach_x),
        _ => (top[error] - bottom[error]) / (2.0 * reach_y),
    })
}

/// How one unit of each common error moves an observed axis or centre: columns in the order of
/// [`ScanErrors::sigmas`], rows the errors of the curve's frame, for a centre its first three. The
/// curve is taken to go along with the displacements where it is.
pub fn curve_error_jacobian(
    seen: &CurvedObservation,
    robot_from_scan: &Isometry3<f64>,
) -> CommonColumns<4> {
    let scan_from_curve = robot_from_scan.inverse() * seen.robot_from_curve;
    let at = |z: f64| {
        let p = (scan_from_curve * Point3::new(0.0, 0.0, z)).coords;
        displacements(&p).map(|field| scan_from_curve.rotation.inverse() * field)
    };
    let middle = at(0.0);
    match seen.kind {
        CurveKind::Sphere => CommonColumns::from_fn(|row, error| match row {
            3 => 0.0,
            _ => middle[error][row],
        }),
        CurveKind::Cylinder => {
            // The standard deviation of a uniform piece is what a fit sees of its length.
            let reach = (0.5 * seen.length_m / 3_f64.sqrt()).max(1e-3);
            let (above, below) = (at(reach), at(-reach));
            CommonColumns::from_fn(|row, error| match row {
                0 | 1 => 0.5 * (above[error][row] + below[error][row]),
                _ => (above[error][row - 2] - below[error][row - 2]) / (2.0 * reach),
            })
        }
    }
}

/// Displacement of a point of the scan frame per unit of each common error.
fn displacements(p: &Vector3<f64>) -> [Vector3<f64>; COMMON] {
    let about_y = Vector3::y().cross(p);
    // Core convention: a positive tilt looks down, as a rotation about y does.
    let tilt = (-p.z).atan2(p.x);
    let range = p.norm().max(1e-9);
    let (sin, cos) = tilt.sin_cos();
    let (mount_ahead, mount_up) =
        (Vector3::new(cos - 1.0, 0.0, -sin), Vector3::new(sin, 0.0, cos - 1.0));
    [about_y, about_y * tilt, p / range, *p, mount_ahead, mount_up]
}

#[cfg(test)]
mod tests {
    use super::super::mask::PlaneMask;
    use super::*;
    use crate::geometry::Plane;
    use nalgebra::{Matrix3, Point2, Rotation3, SymmetricEigen, UnitQuaternion};

    fn patch(pose: Isometry3<f64>) -> Observation {
        let corners = [(-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5)];
        Observation {
            robot_from_plane: pose,
            covariance: Matrix3::identity(),
            hull: corners.map(|(x, y)| Point2::new(x, y)).to_vec(),
            mask: PlaneMask::default(),
            points: 1,
            rms_m: 0.003,
        }
    }

    /// Least-squares plane of displaced points, against which the derivative is held.
    fn refitted(frame: &Isometry3<f64>, error: usize, size: f64) -> Vector3<f64> {
        let mut points = Vec::new();
        for i in -20..=20 {
            for j in -20..=20 {
                let p = frame * Point3::new(f64::from(i) / 20.0, f64::from(j) / 40.0, 0.0);
                points.push(p + displacements(&p.coords)[error] * size);
            }
        }
        let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
        let scatter: Matrix3<f64> =
            points.iter().map(|p| (p.coords - mean) * (p.coords - mean).transpose()).sum();
        let eigen = SymmetricEigen::new(scatter);
        let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        let plane = Plane::through(&Point3::from(mean), &normal).facing(&Point3::origin());
        let local = frame.rotation.inverse() * plane.normal;
        let gap = -plane.distance_m(&Point3::from(frame.translation.vector)) / local.z;
        // A normal tipped by (θ, -ψ).
        Vector3::new(gap, local.x, -local.y)
    }

    #[test]
    fn jacobian_agrees_with_refitting_displaced_points() {
        let towards = |normal: Vector3<f64>, turn: f64| {
            let face = UnitQuaternion::rotation_between(&Vector3::z(), &normal).unwrap();
            face * UnitQuaternion::from_rotation_matrix(&Rotation3::from_axis_angle(
                &Vector3::z_axis(),
                turn,
            ))
        };
        let frames = [
            (Vector3::new(3.0, 0.0, -0.6), Vector3::z(), 0.3),
            (Vector3::new(5.0, 1.0, 0.4), -Vector3::x(), 1.2),
            (Vector3::new(3.0, 2.5, 0.1), Vector3::new(-0.2, -1.0, 0.1).normalize(), -0.7),
        ];
        for (centre, normal, turn) in frames {
            let frame = Isometry3::from_parts(centre.into(), towards(normal, turn));
            let jacobian = common_error_jacobian(&patch(frame), &Isometry3::identity());
            for error in 0..COMMON {
                let size = 1e-4;
                let numeric =
                    (refitted(&frame, error, size) - refitted(&frame, error, -size)) / (2.0 * size);
                let gap = (jacobian.column(error) - numeric).norm();
                assert!(gap < 0.05 * numeric.norm().max(0.3), "{error}: {jacobian} {numeric}");
            }
        }
    }

    #[test]
    fn a_sensor_that_sits_elsewhere_displaces_by_what_the_tilt_turns_of_that() {
        for tilt_rad in [-0.4, 0.0, 0.3, 0.7] {
            let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), tilt_rad);
            let point = turn * Vector3::new(3.0, -1.0, 0.0);
            let [.., ahead, up] = displacements(&point);
            for (found, axis) in [(ahead, Vector3::x()), (up, Vector3::z())] {
                let expected = turn * axis - axis;
                assert!((found - expected).norm() < 1e-12, "{tilt_rad}: {found} {expected}");
            }
        }
    }
}
