//! Finding a joint's servo law from what it did.

use super::servo::{HINGE_GAP_RAD, ServoLaw};
use super::track::{AxisEstimate, AxisTrack};
use crate::geometry::AngleSpan;
use crate::robot::Demand;
use crate::time::{Span, Stamp};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Where the joint was, by a reading or by the laser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// The stamp of the reading or the line.
    pub stamp: Stamp,
    /// Angle in radians.
    pub angle_rad: f64,
    /// Its standard deviation in radians.
    pub sigma_rad: f64,
}

/// A servo law that explains what was observed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ServoFit {
    /// The law.
    pub law: ServoLaw,
    /// Time from sending a command, by the clock's lower bound, to the joint obeying it, on the time
    /// axis of the observations.
    pub delay: Span,
    /// Root mean square of the residuals in radians, outliers left out.
    pub rms_rad: f64,
    /// Standard deviation of the time axis, from the residuals while the joint moved.
    pub time_sigma: Span,
    /// Standard deviation of the law's speed, as a share of it.
    pub speed_sigma: f64,
    /// Observations that the law explains, and observations in all.
    pub explained: (usize, usize),
}

/// Finest residual that is held against a law: readings are cut to this, and frames jitter.
const FLOOR_RAD: f64 = 2e-4;
/// Residuals beyond this many deviations are outliers.
const CUT: f64 = 6.0;
/// Observations by the laser err alike where they are near one another: the speed is this many times as
/// uncertain as if each erred for itself.
const ERR_ALIKE: f64 = 2.0;
/// What the speed is uncertain by where nothing tells.
const SPEED_SIGMA: f64 = 0.03;
/// Most that it is uncertain by.
const MOST_SIGMA: f64 = 0.5;
/// Share of the observations that a law must explain.
const EXPLAINED: f64 = 0.7;
/// A rest of this much means that the law is of another kind.
const WORST_RMS_RAD: f64 = 0.0035;
/// Longest time that a command is taken to be on its way where nobody measured it.
pub(super) const MOST_DELAY: Span = Span::from_millis(5_000);
/// The steps in which that time is first looked for.
const DELAY_STEP: Span = Span::from_millis(200);
/// Where it is looked for first: a server in the same room.
const USUAL_DELAY_S: f64 = 0.03;
/// Fewest observations that a law can be found from.
const FEWEST: usize = 12;

/// The law, of either kind, that explains the observations best; `None` if none does.
///
/// `commands` hold the clock's lower bound at sending; the joint rests at `start_rad` before them and
/// obeys each within `delays` after it, the shortest and the longest.
pub fn identify(
    start_rad: f64,
    limits: Option<AngleSpan>,
    commands: &[(Stamp, Demand)],
    observations: &[Observation],
    prior: Option<ServoLaw>,
    delays: (Span, Span),
) -> Option<ServoFit> {
    if observations.len() < FEWEST || commands.is_empty() {
        return None;
    }
    let case = Case { start_rad, limits, commands, observations, delays };
    let prior_speed = match prior {
        Some(ServoLaw::Hinge { speed_rad_s, .. }) => speed_rad_s,
        Some(ServoLaw::Spring { .. }) | None => 0.17,
    };
    let at_s = delays.0.seconds().max(USUAL_DELAY_S);
    let hinges = [1.0, 0.4, 2.5, 8.0].map(|f| [(prior_speed * f).ln(), HINGE_GAP_RAD.ln(), at_s]);
    let springs = [[2.0, 0.0, at_s], [2.7, -0.7, at_s], [3.4, 0.0, at_s], [2.7, 0.7, at_s]];
    let best = |starts: [[f64; 3]; 4], law_of: fn(&[f64; 3]) -> ServoLaw| {
        // The valley of the true noise is narrow and curved: the search begins with a noise that
        // widens it, and sharpens.
        let search = |start: [f64; 3]| {
            [24.0, 6.0, 1.0, 1.0].into_iter().fold((start, f64::INFINITY), |(x, _), widening| {
                minimise(x, |x| case.cost(law_of(x), x[2], widening))
            })
        };
        // A jump obeyed much later than supposed shares nothing with the one supposed; a joint that creeps
        // looks like a late one.
        let late = |[a, b, supposed_s]: [f64; 3]| {
            let cost = |delay_s: f64| case.cost(law_of(&[a, b, delay_s]), delay_s, 24.0);
            let steps = 0..=(delays.1.0 / DELAY_STEP.0).max(0);
            let delays = steps.map(|i| supposed_s + DELAY_STEP.seconds() * i as f64);
            let best_s = delays.min_by(|a, b| cost(*a).total_cmp(&cost(*b)));
            best_s.filter(|&best_s| best_s > supposed_s).map(|best_s| [a, b, best_s])
        };
        starts
            .into_iter()
            .flat_map(|start| std::iter::once(start).chain(late(start)))
            .map(search)
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|found| again(found, &|x| case.cost(law_of(x), x[2], 1.0), delays))
            .map(|(x, cost)| (law_of(&x), x[2], cost))
    };
    let fits = [best(hinges, hinge_of), best(springs, spring_of)];
    let (law, delay_s, _) = fits.into_iter().flatten().min_by(|a, b| a.2.total_cmp(&b.2))?;
    case.report(law, delay_s)
}

/// The time by which observations of another kind lag the axis of `track`: the lag of lines behind
/// their stamps, for instance, and its standard deviation. `None` if too few of them were made in
/// motion.
///
/// `track` holds the joint's own readings where there are any, so that what is uncertain of its
/// commands, a server's frame for instance, is not mistaken for an uncertain lag.
pub fn lag_of(track: &AxisTrack, observations: &[Observation]) -> Option<(Span, Span)> {
    let cost = |lag_s: f64| {
        let lag = Span::from_seconds(lag_s);
        mean_cost(observations, 1.0, |stamp| track.estimate(stamp + lag))
    };
    let grid = (-20..=80).map(|i| 0.005 * f64::from(i));
    let coarse = grid.min_by(|a, b| cost(*a).total_cmp(&cost(*b)))?;
    let ([lag_s, ..], _) = minimise([coarse, 0.0, 0.0], |x| cost(x[0]));
    let lag = Span::from_seconds(lag_s);
    let residuals = Residuals::of(observations, |stamp| track.estimate(stamp + lag))?;
    residuals.acceptable(observations.len()).then(|| (lag, residuals.time_sigma()))
}

fn hinge_of(x: &[f64; 3]) -> ServoLaw {
    ServoLaw::Hinge {
        speed_rad_s: x[0].clamp(-7.0, 3.0).exp(),
        gap_rad: x[1].clamp(-8.0, 0.5).exp(),
    }
}

fn spring_of(x: &[f64; 3]) -> ServoLaw {
    ServoLaw::Spring {
        frequency_rad_s: x[0].clamp(-1.0, 6.0).exp(),
        damping: x[1].clamp(-3.5, 2.0).exp(),
    }
}

struct Case<'a> {
    start_rad: f64,
    limits: Option<AngleSpan>,
    commands: &'a [(Stamp, Demand)],
    observations: &'a [Observation],
    delays: (Span, Span),
}

impl Case<'_> {
    fn delay(&self, delay_s: f64) -> Span {
        Span::from_seconds(delay_s).min(self.delays.1).max(self.delays.0)
    }

    fn track(&self, law: ServoLaw, delay_s: f64) -> AxisTrack {
        let mut track = AxisTrack::new(Some(law), self.limits, self.start_rad);
        let delay = self.delay(delay_s);
        for &(stamp, demand) in self.commands {
            track.demand(stamp + delay, demand);
        }
        track
    }

    /// The speed's standard deviation, as a share: of the least-squares fit for speed, gap and delay.
    fn speed_sigma(&self, law: ServoLaw, delay_s: f64, residuals: &Residuals) -> f64 {
        const STEP: f64 = 1e-3;
        let track = |speed: f64, other: f64, late_s: f64| {
            self.track(law.changed(speed, other), delay_s + late_s)
        };
        let (here, speed) = (track(0.0, 0.0, 0.0), track(STEP, 0.0, 0.0));
        let (other, late) = (track(0.0, STEP, 0.0), track(0.0, 0.0, STEP));
        let mut information = Matrix3::<f64>::zeros();
        for seen in self.observations {
            let at = |track: &AxisTrack| track.estimate(seen.stamp).map_or(0.0, |e| e.angle_rad);
            let angle_rad = at(&here);
            if (angle_rad - seen.angle_rad).abs() > 3.0 * WORST_RMS_RAD {
                continue;
            }
            let slope =
                Vector3::new(at(&speed), at(&other), at(&late)).add_scalar(-angle_rad) / STEP;
            information += slope * slope.transpose();
        }
        let rms_rad = residuals.rms_rad().max(FLOOR_RAD);
        let variance = information.try_inverse().map(|inverse| inverse[(0, 0)].max(0.0));
        variance
            .map_or(SPEED_SIGMA, |variance| ERR_ALIKE * rms_rad * variance.sqrt())
            .min(MOST_SIGMA)
    }

    fn cost(&self, law: ServoLaw, delay_s: f64, widening: f64) -> f64 {
        let track = self.track(law, delay_s);
        mean_cost(self.observations, widening, |stamp| track.estimate(stamp))
    }

    fn report(&self, law: ServoLaw, delay_s: f64) -> Option<ServoFit> {
        let track = self.track(law, delay_s);
        let residuals = Residuals::of(self.observations, |stamp| track.estimate(stamp))?;
        residuals.acceptable(self.observations.len()).then(|| ServoFit {
            law,
            delay: self.delay(delay_s),
            rms_rad: residuals.rms_rad(),
            time_sigma: residuals.time_sigma(),
            speed_sigma: self.speed_sigma(law, delay_s, &residuals),
            explained: (residuals.explained, self.observations.len()),
        })
    }
}

impl ServoLaw {
    /// The law with its speed, and what else makes it slow, changed by these shares.
    pub(super) fn changed(self, speed_share: f64, other_share: f64) -> Self {
        match self {
            Self::Hinge { speed_rad_s, gap_rad } => Self::Hinge {
                speed_rad_s: speed_rad_s * (1.0 + speed_share),
                gap_rad: gap_rad * (1.0 + other_share),
            },
            Self::Spring { frequency_rad_s, damping } => Self::Spring {
                frequency_rad_s: frequency_rad_s * (1.0 + speed_share),
                damping: damping * (1.0 + other_share),
            },
        }
    }
}

/// Mean squared residual in deviations, `widening` times the true ones, cut.
fn mean_cost(
    observations: &[Observation],
    widening: f64,
    estimate: impl Fn(Stamp) -> Option<AxisEstimate>,
) -> f64 {
    let sum: f64 = observations
        .iter()
        .map(|seen| {
            let angle_rad = estimate(seen.stamp).map_or(f64::MAX, |e| e.angle_rad);
            let sigma = widening * seen.sigma_rad.max(FLOOR_RAD);
            let residual = (angle_rad - seen.angle_rad) / sigma;
            // Beyond the cut the cost still grows a little, so that a search far off finds home.
            let square = residual * residual;
            if square > CUT * CUT { CUT * CUT + (square / (CUT * CUT)).ln() } else { square }
        })
        .sum();
    sum / observations.len().max(1) as f64
}

/// What a model leaves of observations, outliers left out.
#[derive(Clone, Copy, Debug, Default)]
struct Residuals {
    explained: usize,
    squares: f64,
    /// Squares of residuals, and of rates, of what was observed in motion.
    moving_squares: f64,
    rate_squares: f64,
}

impl Residuals {
    /// `None` where the model says nothing about one of the observations.
    fn of(
        observations: &[Observation],
        estimate: impl Fn(Stamp) -> Option<AxisEstimate>,
    ) -> Option<Self> {
        let mut sums = Self::default();
        for seen in observations {
            let estimate = estimate(seen.stamp)?;
            let residual = estimate.angle_rad - seen.angle_rad;
            // Outliers are told by the angle, not by the precision of the reading: a joint that
            // moves at 10°/s is a tenth of a degree off after a hundredth of a second.
            if residual.abs() > 3.0 * WORST_RMS_RAD {
                continue;
            }
            sums.explained += 1;
            sums.squares += residual * residual;
            const MOVING_RAD_S: f64 = 0.01;
            if estimate.rate_rad_s.abs() > MOVING_RAD_S {
                sums.moving_squares += residual * residual;
                sums.rate_squares += estimate.rate_rad_s * estimate.rate_rad_s;
            }
        }
        Some(sums)
    }

    fn rms_rad(&self) -> f64 {
        (self.squares / self.explained.max(1) as f64).sqrt()
    }

    fn time_sigma(&self) -> Span {
        Span::from_seconds((self.moving_squares / self.rate_squares).sqrt().max(0.001))
    }

    /// Whether the model explains enough of `all` observations, well enough, some of them in motion.
    fn acceptable(&self, all: usize) -> bool {
        let enough = self.explained as f64 >= EXPLAINED * all as f64;
        enough && self.rms_rad() <= WORST_RMS_RAD && self.rate_squares > 0.0
    }
}

/// Searches on from what a search found as long as that gains: a simplex that has collapsed on the way, as
/// at the shortest delay, beyond which nothing changes, is spread out again.
fn again(
    mut found: ([f64; 3], f64),
    cost: &impl Fn(&[f64; 3]) -> f64,
    delays: (Span, Span),
) -> ([f64; 3], f64) {
    const TIMES: usize = 4;
    const GAIN: f64 = 0.99;
    for _ in 0..TIMES {
        let [a, b, delay_s] = found.0;
        let delay_s = delay_s.clamp(delays.0.seconds(), delays.1.seconds());
        let next = minimise([a, b, delay_s], cost);
        if next.1 >= GAIN * found.1 {
            break;
        }
        found = next;
    }
    found
}

/// Nelder and Mead's simplex search in three unknowns, from `start` with steps suited to logarithms
/// and to a delay in seconds. Returns the best point and its cost.
fn minimise(start: [f64; 3], cost: impl Fn(&[f64; 3]) -> f64) -> ([f64; 3], f64) {
    const STEPS: [f64; 3] = [0.3, 0.3, 0.04];
    const ROUNDS: usize = 160;
    let mut simplex: Vec<([f64; 3], f64)> = vec![(start, cost(&start))];
    for axis in 0..3 {
        let mut corner = start;
        corner[axis] += STEPS[axis];
        simplex.push((corner, cost(&corner)));
    }
    for _ in 0..ROUNDS {
        // A stable sort: of equal costs the older corner stays ahead.
        simplex.sort_by(|a, b| a.1.total_cmp(&b.1));
        let worst = simplex[3];
        if worst.1 - simplex[0].1 <= 1e-7 * (1e-3 + simplex[0].1) {
            break;
        }
        let centre: [f64; 3] =
            std::array::from_fn(|i| simplex[..3].iter().map(|c| c.0[i]).sum::<f64>() / 3.0);
        let towards = |scale: f64| {
            let x: [f64; 3] = std::array::from_fn(|i| centre[i] + scale * (worst.0[i] - centre[i]));
            (x, cost(&x))
        };
        let reflected = towards(-1.0);
        if reflected.1 < simplex[0].1 {
            let expanded = towards(-2.0);
            simplex[3] = if expanded.1 < reflected.1 { expanded } else { reflected };
        } else if reflected.1 < simplex[2].1 {
            simplex[3] = reflected;
        } else {
            let contracted = towards(if reflected.1 < worst.1 { -0.5 } else { 0.5 });
            if contracted.1 < worst.1.min(reflected.1) {
                simplex[3] = contracted;
            } else {
                let best = simplex[0].0;
                for corner in &mut simplex[1..] {
                    let x = std::array::from_fn(|i| 0.5 * (best[i] + corner.0[i]));
                    *corner = (x, cost(&x));
                }
            }
        }
    }
    simplex.sort_by(|a, b| a.1.total_cmp(&b.1));
    simplex[0]
}

#[cfg(test)]
mod tests {
    use super::super::track::AxisReading;
    use super::*;
    use proptest::prelude::*;

    const FROM_NOW: (Span, Span) = (Span::ZERO, MOST_DELAY);

    fn s(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    /// A calibration motion and what is read of it every 0.2 s, with a little noise.
    fn observed(
        law: ServoLaw,
        delay_s: f64,
        lag_s: f64,
    ) -> (Vec<(Stamp, Demand)>, Vec<Observation>) {
        let mut commands = vec![(s(1.0), Demand::Angle(0.14)), (s(2.87), Demand::Angle(0.0))];
        commands.extend(
            (0..8).map(|i| (s(4.6 + 0.2 * f64::from(i)), Demand::Angle(0.0044 * f64::from(i + 1)))),
        );
        commands.push((s(6.93), Demand::Angle(0.14)));
        let mut track = AxisTrack::new(Some(law), None, 0.0);
        for &(stamp, demand) in &commands {
            track.demand(stamp + Span::from_seconds(delay_s), demand);
        }
        let observations = (0..42)
            .map(|i| {
                let stamp = s(0.4 + 0.2 * f64::from(i));
                let at = track.estimate(stamp + Span::from_seconds(lag_s)).unwrap().angle_rad;
                let noise = 1e-4 * (f64::from(i) * 12.9898).sin();
                Observation { stamp, angle_rad: at + noise, sigma_rad: 2e-4 }
            })
            .collect();
        (commands, observations)
    }

    fn track(fit: &ServoFit, commands: &[(Stamp, Demand)], readings: &[Observation]) -> AxisTrack {
        let mut track = AxisTrack::new(Some(fit.law), None, 0.0);
        for &(stamp, demand) in commands {
            track.demand(stamp + fit.delay, demand);
        }
        for r in readings {
            let (stamp, angle_rad) = (r.stamp, r.angle_rad);
            track.read(AxisReading { stamp, angle_rad, half_width_rad: r.sigma_rad });
        }
        track
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn a_hinge_is_found_again(
            speed in 0.08..0.6f64, gap_deg in 1.0..3.0f64, delay in 0.0..0.15f64, lag in 0.0..0.2f64
        ) {
            let law = ServoLaw::Hinge { speed_rad_s: speed, gap_rad: gap_deg.to_radians() };
            let (commands, readings) = observed(law, delay, 0.0);
            let fit = identify(0.0, None, &commands, &readings, Some(ServoLaw::hinge(0.17)), FROM_NOW).unwrap();
            prop_assert!((fit.delay.seconds() - delay).abs() < 0.008, "{fit:?} for {law:?}");
            prop_assert!(fit.rms_rad < 2e-4, "{fit:?}");
            let (_, lines) = observed(law, delay, lag);
            let (found, sigma) = lag_of(&track(&fit, &commands, &readings), &lines).unwrap();
            prop_assert!(sigma < Span::from_millis(8), "{sigma:?}");
            prop_assert!((found.seconds() - lag).abs() < 0.008, "{} for {lag}", found.seconds());
        }

        #[test]
        fn a_spring_is_found_again(frequency in 4.0..25.0f64, damping in 0.3..1.5f64, delay in 0.0..0.1f64) {
            let law = ServoLaw::Spring { frequency_rad_s: frequency, damping };
            let (commands, readings) = observed(law, delay, 0.0);
            let fit = identify(0.0, None, &commands, &readings, None, FROM_NOW).unwrap();
            prop_assert!(fit.rms_rad < 4e-4, "{fit:?} for {law:?} {delay}");
        }
    }

    #[test]
    fn a_spring_that_creeps_is_no_late_hinge() {
        for (frequency_rad_s, damping, delay) in [(4.037, 1.471, 0.057), (4.27, 1.48, 0.006)] {
            let (commands, readings) =
                observed(ServoLaw::Spring { frequency_rad_s, damping }, delay, 0.0);
            let fit = identify(0.0, None, &commands, &readings, None, FROM_NOW).unwrap();
            assert!(fit.rms_rad < 4e-4, "{fit:?} for {frequency_rad_s} {damping}");
        }
    }

    #[test]
    fn a_quick_spring_whose_search_collapses_at_no_delay_is_found() {
        let law = ServoLaw::Spring { frequency_rad_s: 20.013_152_8, damping: 0.343_664_57 };
        let (commands, readings) = observed(law, 0.010_593_96, 0.0);
        let fit = identify(0.0, None, &commands, &readings, None, FROM_NOW).unwrap();
        assert!(fit.rms_rad < 4e-4, "{fit:?}");
    }

    #[test]
    fn no_joint_obeys_before_it_is_told() {
        // Readings stamped 30 ms early, as a clock that was read too late makes them look.
        let law = ServoLaw::hinge(0.17);
        let (commands, readings) = observed(law, -0.03, 0.0);
        let free =
            identify(0.0, None, &commands, &readings, None, (Span::from_millis(-1000), MOST_DELAY))
                .unwrap();
        assert!(free.delay < Span::from_millis(-25), "{free:?}");
        let bound = identify(0.0, None, &commands, &readings, None, FROM_NOW);
        assert!(bound.is_none_or(|fit| fit.delay >= Span::ZERO), "{bound:?}");
    }

    #[test]
    fn what_no_law_explains_is_not_explained() {
        let (commands, mut readings) = observed(ServoLaw::hinge(0.17), 0.02, 0.0);
        for (i, reading) in readings.iter_mut().enumerate() {
            reading.angle_rad = 0.1 * ((i * i) as f64).sin();
        }
        assert_eq!(identify(0.0, None, &commands, &readings, None, FROM_NOW), None);
        assert_eq!(identify(0.0, None, &commands, &readings[..5], None, FROM_NOW), None);
    }
}
