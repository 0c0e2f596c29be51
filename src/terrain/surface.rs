//! The surfaces of one cell: what one could stand on, and the signs that there is nothing to stand on.

use serde::{Deserialize, Serialize};

/// How a piece of ground came to be known, from the weakest to the strongest.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub enum Seen {
    /// Taken for ground because the robot stood there; never measured.
    #[default]
    Assumed,
    /// Between two measured ground points of one scan whose spacing a plane explains.
    Interpolated,
    /// The robot stood on it while driving; never measured.
    Driven,
    /// A measured point lies in the cell.
    Measured,
}

/// A surface in a cell that could be stood on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Surface {
    /// Height in the map frame, metres.
    pub z_m: f32,
    /// Standard deviation of the height, metres.
    pub sigma_m: f32,
    /// Least horizontal distance from which a point of it was measured, metres; infinite if never.
    pub seen_from_m: f32,
    /// Number of the last scan that saw it.
    pub scan: u32,
    /// How it came to be known.
    pub seen: Seen,
    /// Measured points, saturating.
    pub points: u8,
    contested: u8,
    contested_scan: u32,
}

/// Sign that a cell holds no ground at the height of the ground beside it.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub enum Void {
    /// No such sign.
    #[default]
    None,
    /// Ground due here did not return, or returned lower and farther; a ramp is not excluded.
    Suspected,
    /// A ray went lower than any slope the robot may drive would let it.
    Proven,
}

/// One observation of ground in a cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Observation {
    pub z_m: f64,
    pub sigma_m: f64,
    pub distance_m: f64,
    pub seen: Seen,
    pub scan: u32,
}

/// Surfaces kept per cell.
pub(super) const SURFACES: usize = 3;

/// Heights nearer than this are one surface, whatever their variances: below it lies pose noise,
/// above it a step that matters to small robots.
const SAME_SURFACE_M: f64 = 0.06;
/// Heights farther apart than this are two surfaces, whatever their variances.
const OTHER_SURFACE_M: f64 = 0.15;
/// Surfaces nearer than this cannot both be true of open ground: no robot fits between them.
const RIVAL_M: f64 = 0.30;
/// No number of points makes a height better than this: poses err by as much.
const BEST_SIGMA_M: f64 = 0.008;
/// What a height may have moved by since the last scan, through the pose's drift.
const DRIFT_SIGMA_M: f64 = 0.01;
/// Scans that must contradict a measured surface before it goes.
const CONTESTS: u8 = 2;

/// Everything about ground in one cell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct GroundCell {
    surfaces: [Surface; SURFACES],
    count: u8,
    pub void: Void,
    /// Height of the ground that the void breaks, metres.
    pub void_z_m: f32,
}

impl GroundCell {
    /// The surfaces known here, in no order.
    pub fn surfaces(&self) -> &[Surface] {
        &self.surfaces[..usize::from(self.count)]
    }

    /// The surface nearest to `z_m` and at most `reach_m` from it.
    pub fn nearest(&self, z_m: f64, reach_m: f64) -> Option<&Surface> {
        self.surfaces()
            .iter()
            .map(|surface| ((f64::from(surface.z_m) - z_m).abs(), surface))
            .filter(|(distance_m, _)| *distance_m <= reach_m)
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, surface)| surface)
    }

    fn remove(&mut self, index: usize) {
        self.count -= 1;
        self.surfaces.swap(index, usize::from(self.count));
    }

    /// Takes in one observation of ground.
    pub fn observe(&mut self, seen: &Observation) {
        // Where ground was seen to be missing, ground on both sides proves nothing.
        let near_void = (seen.z_m - f64::from(self.void_z_m)).abs() < RIVAL_M;
        if self.void == Void::Proven && seen.seen == Seen::Interpolated && near_void {
            return;
        }
        match self.matching(seen) {
            Some(index) => self.surfaces[index].fuse(seen),
            None => self.add(seen),
        }
        let clears = match self.void {
            Void::None => false,
            Void::Suspected => seen.seen >= Seen::Interpolated,
            Void::Proven => seen.seen == Seen::Measured,
        };
        if clears && near_void {
            self.void = Void::None;
        }
    }

    fn matching(&self, seen: &Observation) -> Option<usize> {
        let mut best = None;
        for (index, surface) in self.surfaces().iter().enumerate() {
            let guessed = |seen: Seen| matches!(seen, Seen::Assumed | Seen::Driven);
            let gate_m = if guessed(surface.seen) || guessed(seen.seen) {
                OTHER_SURFACE_M
            } else {
                let sigma_m = seen.sigma_m.hypot(f64::from(surface.sigma_m));
                (2.5 * sigma_m).clamp(SAME_SURFACE_M, OTHER_SURFACE_M)
            };
            let away_m = (f64::from(surface.z_m) - seen.z_m).abs();
            if away_m <= gate_m && best.is_none_or(|(_, least_m)| away_m < least_m) {
                best = Some((index, away_m));
            }
        }
        best.map(|(index, _)| index)
    }

    fn add(&mut self, seen: &Observation) {
        let mut index = 0;
        while index < usize::from(self.count) {
            let surface = &mut self.surfaces[index];
            if (f64::from(surface.z_m) - seen.z_m).abs() < RIVAL_M {
                if surface.seen > seen.seen {
                    return;
                }
                if surface.seen < seen.seen || surface.contest(seen.scan) {
                    self.remove(index);
                    continue;
                }
            }
            index += 1;
        }
        if usize::from(self.count) == SURFACES {
            // The least certain makes room; equal ones by index.
            let weakest = (0..SURFACES)
                .min_by(|&a, &b| {
                    let (a, b) = (&self.surfaces[a], &self.surfaces[b]);
                    a.seen.cmp(&b.seen).then(b.sigma_m.total_cmp(&a.sigma_m))
                })
                .expect("a cell keeps at least one surface");
            self.remove(weakest);
        }
        self.surfaces[usize::from(self.count)] = Surface::new(seen);
        self.count += 1;
    }

    /// Asks for each surface whether rays of `scan` passed closely beneath it (`passed` is given the
    /// lowest and highest height that would contradict it). Measured surfaces go after
    /// [`CONTESTS`] such scans, interpolated ones at once.
    ///
    /// Only what passes closely is a contradiction: a table stays a table for those who look under
    /// it from afar, and its top stays an obstacle in any case, by the hits in its column.
    pub fn undercut(&mut self, scan: u32, passed: impl Fn(f64, f64) -> bool) {
        let mut index = 0;
        while index < usize::from(self.count) {
            let surface = &mut self.surfaces[index];
            let high_m = f64::from(surface.z_m) - 0.10 - 2.0 * f64::from(surface.sigma_m);
            let gone = match surface.seen {
                Seen::Assumed | Seen::Driven => false,
                Seen::Interpolated => passed(high_m - 0.25, high_m),
                Seen::Measured => {
                    surface.scan != scan && passed(high_m - 0.25, high_m) && surface.contest(scan)
                }
            };
            if gone {
                self.remove(index);
            } else {
                index += 1;
            }
        }
    }

    /// Marks that ground at `z_m` was due here and is missing. Ground that was measured or stood on
    /// stays; what was only interpolated goes where a ray proves it wrong.
    pub fn mark_void(&mut self, z_m: f64, void: Void) {
        if void == Void::Proven {
            let mut index = 0;
            while index < usize::from(self.count) {
                let surface = &self.surfaces[index];
                let here = (f64::from(surface.z_m) - z_m).abs() <= OTHER_SURFACE_M;
                if here && surface.seen == Seen::Interpolated {
                    self.remove(index);
                } else {
                    index += 1;
                }
            }
        }
        if self.nearest(z_m, OTHER_SURFACE_M).is_none() && void >= self.void {
            self.void = void;
            self.void_z_m = z_m as f32;
        }
    }
}

impl Surface {
    fn new(seen: &Observation) -> Self {
        let measured = seen.seen == Seen::Measured;
        Self {
            z_m: seen.z_m as f32,
            sigma_m: seen.sigma_m.max(BEST_SIGMA_M) as f32,
            seen_from_m: if measured { seen.distance_m as f32 } else { f32::INFINITY },
            scan: seen.scan,
            seen: seen.seen,
            points: u8::from(measured),
            contested: 0,
            contested_scan: 0,
        }
    }

    fn fuse(&mut self, seen: &Observation) {
        if seen.seen < self.seen {
            return;
        }
        if seen.seen > self.seen {
            *self = Self::new(seen);
            return;
        }
        let drift = if seen.scan == self.scan { 0.0 } else { DRIFT_SIGMA_M };
        let prior = f64::from(self.sigma_m).powi(2) + drift * drift;
        let gain = prior / (prior + seen.sigma_m.powi(2));
        self.z_m += (gain * (seen.z_m - f64::from(self.z_m))) as f32;
        self.sigma_m = ((1.0 - gain) * prior).sqrt().max(BEST_SIGMA_M) as f32;
        self.scan = seen.scan;
        self.contested = 0;
        if seen.seen == Seen::Measured {
            self.seen_from_m = self.seen_from_m.min(seen.distance_m as f32);
            self.points = self.points.saturating_add(1);
        }
    }

    /// Counts one contradiction per scan; true when it is one too many.
    fn contest(&mut self, scan: u32) -> bool {
        if self.contested_scan != scan && self.scan != scan {
            self.contested_scan = scan;
            self.contested += 1;
        }
        self.contested >= CONTESTS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ground(z_m: f64, seen: Seen, scan: u32) -> Observation {
        Observation { z_m, sigma_m: 0.01, distance_m: 2.0, seen, scan }
    }

    #[test]
    fn floor_and_bridge_in_one_cell_stay_two_surfaces() {
        let mut cell = GroundCell::default();
        for scan in 1..5 {
            cell.observe(&ground(0.01 * f64::from(scan % 2), Seen::Measured, scan));
            cell.observe(&ground(2.5, Seen::Measured, scan));
        }
        assert_eq!(cell.surfaces().len(), 2);
        assert!((cell.nearest(0.0, 0.1).unwrap().z_m).abs() < 0.02);
    }

    #[test]
    fn a_proven_void_outlasts_interpolation_and_yields_to_measured_ground() {
        let mut cell = GroundCell::default();
        cell.observe(&ground(0.0, Seen::Interpolated, 1));
        cell.mark_void(0.0, Void::Suspected);
        assert_eq!((cell.surfaces().len(), cell.void), (1, Void::None));
        cell.mark_void(0.0, Void::Proven);
        cell.observe(&ground(0.0, Seen::Interpolated, 2));
        assert_eq!((cell.surfaces().len(), cell.void), (0, Void::Proven));
        // Another level is none of its business.
        cell.observe(&ground(1.0, Seen::Interpolated, 2));
        cell.observe(&ground(0.0, Seen::Measured, 3));
        assert_eq!((cell.surfaces().len(), cell.void), (2, Void::None));
        cell.mark_void(0.0, Void::Proven);
        assert_eq!((cell.surfaces().len(), cell.void), (2, Void::None));
    }

    #[test]
    fn measured_ground_outranks_interpolated_and_assumed() {
        let mut cell = GroundCell::default();
        cell.observe(&ground(0.0, Seen::Assumed, 0));
        cell.observe(&ground(0.05, Seen::Interpolated, 1));
        cell.observe(&ground(0.20, Seen::Measured, 2));
        cell.observe(&ground(0.05, Seen::Interpolated, 3));
        assert_eq!(cell.surfaces().len(), 1);
        assert_eq!(cell.surfaces()[0].seen, Seen::Measured);
        assert!((cell.surfaces()[0].z_m - 0.20).abs() < 1e-6);
    }

    #[test]
    fn a_surface_two_scans_look_under_is_gone() {
        let mut cell = GroundCell::default();
        cell.observe(&ground(0.5, Seen::Measured, 1));
        let beneath = |low_m: f64, high_m: f64| low_m < 0.3 && 0.3 < high_m;
        cell.undercut(2, beneath);
        cell.undercut(2, beneath);
        assert_eq!(cell.surfaces().len(), 1, "one scan is not enough");
        cell.undercut(3, |_, _| false);
        cell.undercut(4, beneath);
        assert!(cell.surfaces().is_empty());
    }

    #[test]
    fn a_table_top_outlives_rays_far_beneath_it() {
        let mut cell = GroundCell::default();
        cell.observe(&ground(0.7, Seen::Measured, 1));
        for scan in 2..9 {
            cell.undercut(scan, |low_m, high_m| low_m < 0.2 && 0.2 < high_m);
        }
        assert_eq!(cell.surfaces().len(), 1);
    }

    #[test]
    fn seen_ground_answers_a_suspicion() {
        let mut cell = GroundCell::default();
        cell.mark_void(0.0, Void::Suspected);
        assert_eq!(cell.void, Void::Suspected);
        cell.observe(&ground(-0.02, Seen::Measured, 1));
        assert_eq!(cell.void, Void::None);
        cell.mark_void(0.0, Void::Proven);
        assert_eq!(cell.void, Void::None, "a mark does not wipe out seen ground");
    }
}
