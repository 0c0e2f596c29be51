//! The choice itself: candidates, their worth per second, hysteresis, and the reasons.

use super::frontier::{Frontier, frontiers};
use super::view::{COARSE, ViewMap};
use super::{Choice, Decision, Explorer, FrontierLeft};
use crate::geometry::wrap_pi;
use crate::navigation::{CostField, CostMap, Planner, Pose2};
use crate::terrain::{CellIndex, Grid, RobotShape};
use crate::time::Arrival;

/// Candidates evaluated per choice at most; the spacing is widened until they are no more.
const MOST_CANDIDATES: usize = 1500;
/// A frontier this near to a goal's view is the one it is named after.
const FACED_M: f64 = 6.0;

/// Room beyond the turning circle that a place to look from should have, in metres: how far odometry
/// and the follower may miss it.
const SPARE_M: f64 = 0.15;

/// What a place with less room is charged, in seconds: the risk of getting wedged there.
const TIGHT_S: f64 = 15.0;

/// A place from which to look.
struct Candidate {
    cell: CellIndex,
    x_m: f64,
    y_m: f64,
    way_m: f64,
    travel_s: f64,
    /// Upper bound of its worth per second.
    bound: f64,
}

impl Explorer {
    /// The best place to sweep from next, for a robot at `pose`.
    ///
    /// Worth is square metres newly seen per second of driving, turning and sweeping. The current
    /// goal is kept unless another is better by [`ExploreConfig::hysteresis`](super::ExploreConfig).
    /// Costs one search over the reachable ground and some hundred ray fans.
    pub fn choose(
        &mut self,
        grid: &Grid,
        costs: &CostMap,
        shape: &RobotShape,
        planner: &mut Planner,
        pose: &Pose2,
        now: Arrival,
    ) -> Decision {
        let from = grid.cell_of(pose.x_m, pose.y_m);
        let field = planner.field(costs, from);
        let mut view = ViewMap::new(grid, &self.looks);
        let turning_m = shape.circumscribed_radius_m();
        let found = frontiers(grid, self.config.least_frontier_cells);
        let candidates = self.candidates(grid, &field, shape, &view, pose, now);
        let kept = self.current.take().and_then(|current| {
            self.weigh(&mut view, &field, pose, current.cell, grid, turning_m)
                .filter(|choice| choice.gain_m2 >= self.config.least_gain_m2)
                .filter(|choice| self.is_open(&choice.goal, now) && self.is_in_time(choice))
                .map(|choice| Choice { kept: true, ..choice })
        });
        let mut best: Option<Choice> = None;
        let mut tried = 0;
        for candidate in &candidates {
            let least = best.as_ref().map_or(0.0, worth);
            if candidate.bound <= least {
                break;
            }
            tried += 1;
            let Some(choice) = self.weigh(&mut view, &field, pose, candidate.cell, grid, turning_m)
            else {
                continue;
            };
            if choice.gain_m2 >= self.config.least_gain_m2
                && worth(&choice) > least
                && self.is_in_time(&choice)
            {
                best = Some(choice);
            }
        }
        let chosen = match (kept, best) {
            (Some(kept), Some(best)) if worth(&best) > self.config.hysteresis * worth(&kept) => {
                Some(best)
            }
            (Some(kept), _) => Some(kept),
            (None, best) => best,
        };
        let Some(mut choice) = chosen else {
            return Decision::NothingLeft {
                frontiers_left: self.explain(grid, &field, found, now),
                retry_at: self.failed.next_opening(now),
            };
        };
        choice.frontier = faced(&found, &choice.goal);
        choice.reasons = self.reasons(&choice, candidates.len(), tried, found.len());
        self.current = Some(choice.clone());
        Decision::Go(choice)
    }

    /// Frontiers as the grid shows them now.
    pub fn frontiers(&self, grid: &Grid) -> Vec<Frontier> {
        frontiers(grid, self.config.least_frontier_cells)
    }

    /// Limits the choice to places where a sweep would be over within `seconds`; `None` lifts it.
    pub fn limit_time(&mut self, seconds: Option<f64>) {
        self.time_left_s = seconds;
    }

    fn is_in_time(&self, choice: &Choice) -> bool {
        self.time_left_s.is_none_or(|left_s| choice.seconds <= left_s)
    }

    fn is_open(&self, goal: &Pose2, now: Arrival) -> bool {
        self.failed.closing(&goal.point(), now, self.config.failure_radius_m).is_none()
    }

    /// Places to look from, the one that could be worth most first.
    fn candidates(
        &self,
        grid: &Grid,
        field: &CostField,
        shape: &RobotShape,
        view: &ViewMap,
        pose: &Pose2,
        now: Arrival,
    ) -> Vec<Candidate> {
        let mut spacing = (self.config.candidate_spacing_m / grid.cell_m()).round().max(1.0) as i32;
        let mut cells = roomiest(grid, field, spacing);
        while cells.len() > MOST_CANDIDATES {
            spacing += (spacing + 1) / 2;
            cells = roomiest(grid, field, spacing);
        }
        let sums = view.unknown_sums();
        let turning_m = shape.circumscribed_radius_m();
        let mut candidates: Vec<Candidate> = cells
            .into_iter()
            .filter_map(|cell| {
                let centre = grid.centre(cell);
                let goal = Pose2 { x_m: centre.x, y_m: centre.y, yaw_rad: 0.0 };
                // A view pose must let the robot turn to its heading.
                if f64::from(grid.get(cell).room_m) < turning_m || !self.is_open(&goal, now) {
                    return None;
                }
                let way_m = field.cost_m(cell)?;
                let travel_s =
                    self.travel_s(pose, &goal, way_m) + tightness_s(grid, cell, turning_m);
                let reach_m = self.config.view_range_m;
                let bound_m2 = view.bound_m2(&sums, centre.x, centre.y, reach_m);
                let bound = bound_m2 / (travel_s + self.config.scan_s);
                Some(Candidate { cell, x_m: centre.x, y_m: centre.y, way_m, travel_s, bound })
            })
            .collect();
        candidates.sort_by(|a, b| {
            b.bound
                .total_cmp(&a.bound)
                .then(a.travel_s.total_cmp(&b.travel_s))
                .then(a.way_m.total_cmp(&b.way_m))
                .then(
                    (a.x_m, a.y_m)
                        .partial_cmp(&(b.x_m, b.y_m))
                        .unwrap_or(std::cmp::Ordering::Equal),
                )
        });
        candidates
    }

    /// Time to drive `way_m` to a goal, with the turn towards it.
    fn travel_s(&self, pose: &Pose2, goal: &Pose2, way_m: f64) -> f64 {
        let turn_rad = if way_m < 0.1 { 0.0 } else { pose.bearing_rad(&goal.point()).abs() };
        way_m / self.config.speed_mps + turn_rad / self.config.turn_rps
    }

    fn weigh(
        &self,
        view: &mut ViewMap,
        field: &CostField,
        pose: &Pose2,
        cell: CellIndex,
        grid: &Grid,
        turning_m: f64,
    ) -> Option<Choice> {
        let way_m = field.cost_m(cell)?;
        let centre = grid.centre(cell);
        let mut goal = Pose2 { x_m: centre.x, y_m: centre.y, yaw_rad: pose.yaw_rad };
        let travel_s = self.travel_s(pose, &goal, way_m);
        let arrives_rad = if way_m < 0.1 {
            pose.yaw_rad
        } else {
            wrap_pi(pose.yaw_rad + pose.bearing_rad(&centre))
        };
        let config = &self.config;
        let mut gain = view.gain(
            goal.x_m,
            goal.y_m,
            config.blind_m,
            config.close_range_m,
            config.view_range_m,
        );
        self.vain.discount(&centre, &mut gain);
        let (yaw_rad, gain_m2) = gain.best(config.field_of_view_rad, arrives_rad);
        goal.yaw_rad = yaw_rad;
        let turn_s = wrap_pi(yaw_rad - arrives_rad).abs() / config.turn_rps;
        Some(Choice {
            goal,
            cell,
            gain_m2,
            way_m,
            seconds: travel_s + turn_s + config.scan_s + tightness_s(grid, cell, turning_m),
            frontier: None,
            kept: false,
            reasons: Vec::new(),
        })
    }

    fn reasons(
        &self,
        choice: &Choice,
        places: usize,
        tried: usize,
        frontiers: usize,
    ) -> Vec<String> {
        let mut reasons = vec![
            format!(
                "a sweep here should show {:.1} m² of unseen ground for {:.0} s ({:.2} m²/s)",
                choice.gain_m2,
                choice.seconds,
                worth(choice)
            ),
            format!("the way costs {:.1} m of good ground", choice.way_m),
            format!(
                "best of {places} places to look from ({tried} weighed), {frontiers} frontiers known"
            ),
        ];
        if choice.kept {
            reasons.push(format!(
                "kept from before: nothing else is {:.1} times better",
                self.config.hysteresis
            ));
        }
        if let Some(frontier) = &choice.frontier {
            let kind = if frontier.suspect { "a suspected edge" } else { "unknown ground" };
            reasons.push(format!(
                "it faces the frontier at ({:.1}, {:.1}), {} cells beside {kind}",
                frontier.at.x, frontier.at.y, frontier.cells
            ));
        }
        reasons
    }

    /// Why each frontier stays.
    fn explain(
        &self,
        grid: &Grid,
        field: &CostField,
        found: Vec<Frontier>,
        now: Arrival,
    ) -> Vec<FrontierLeft> {
        let reason = |frontier: &Frontier| {
            if let Some(goal) =
                self.failed.closing(&frontier.at, now, 2.0 * self.config.failure_radius_m)
            {
                return format!(
                    "a goal nearby failed {} times ({}) and is left alone until {}",
                    goal.times, goal.reason, goal.until
                );
            }
            let looks = self.looks_beside(frontier.cell);
            let gets_near = nearest_reachable_m(grid, field, frontier.cell);
            match gets_near {
                None => {
                    "no reachable ground within 3 m: the ways there are closed or too narrow".into()
                }
                _ if frontier.suspect => {
                    format!("a drop-off is suspected here; looked at {looks} times from nearby")
                }
                _ if looks > 0 => format!("looked at {looks} times and nothing came back"),
                Some(away_m) => format!(
                    "too little to see ({} cells, {away_m:.1} m from reachable ground)",
                    frontier.cells
                ),
            }
        };
        found
            .iter()
            .map(|frontier| FrontierLeft {
                x: frontier.at.x,
                y: frontier.at.y,
                cells: frontier.cells,
                reason: reason(frontier),
            })
            .collect()
    }

    fn looks_beside(&self, cell: CellIndex) -> u8 {
        let (x, y) = (cell.x.div_euclid(COARSE), cell.y.div_euclid(COARSE));
        (-1..=1)
            .flat_map(|dy| (-1..=1).map(move |dx| CellIndex { x: x + dx, y: y + dy }))
            .map(|cell| self.looks.count(cell))
            .max()
            .unwrap_or(0)
    }
}

/// What it costs that a place has hardly room to turn, in seconds.
fn tightness_s(grid: &Grid, cell: CellIndex, turning_m: f64) -> f64 {
    if f64::from(grid.get(cell).room_m) < turning_m + SPARE_M { TIGHT_S } else { 0.0 }
}

/// Square metres per second.
fn worth(choice: &Choice) -> f64 {
    choice.gain_m2 / choice.seconds.max(1e-3)
}

/// In each block of `spacing` cells the reachable one with most room; of equal ones the first.
fn roomiest(grid: &Grid, field: &CostField, spacing: i32) -> Vec<CellIndex> {
    let low = grid.low();
    let columns = grid.width() / spacing as usize + 1;
    let rows = grid.height() / spacing as usize + 1;
    let mut blocks: Vec<Option<(f32, CellIndex)>> = vec![None; columns * rows];
    for (cell, value) in grid.iter() {
        if !value.reachable {
            continue;
        }
        let block =
            ((cell.y - low.y) / spacing) as usize * columns + ((cell.x - low.x) / spacing) as usize;
        if blocks[block].is_none_or(|(room_m, _)| value.room_m > room_m)
            && field.cost_m(cell).is_some()
        {
            blocks[block] = Some((value.room_m, cell));
        }
    }
    blocks.into_iter().flatten().map(|(_, cell)| cell).collect()
}

/// The largest frontier near the view from a goal.
fn faced(found: &[Frontier], goal: &Pose2) -> Option<Frontier> {
    found
        .iter()
        .filter(|frontier| {
            goal.distance_m(&frontier.at) <= FACED_M
                && goal.bearing_rad(&frontier.at).abs() <= std::f64::consts::FRAC_PI_2
        })
        .max_by(|a, b| a.cells.cmp(&b.cells).then(b.cell.cmp(&a.cell)))
        .cloned()
}

/// Distance from a cell to the nearest ground that can be reached, if within 3 m.
fn nearest_reachable_m(grid: &Grid, field: &CostField, cell: CellIndex) -> Option<f64> {
    let reach = (3.0 / grid.cell_m()) as i32;
    let mut nearest: Option<f64> = None;
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let away_m = f64::from(dx).hypot(f64::from(dy)) * grid.cell_m();
            if away_m > 3.0 || nearest.is_some_and(|least_m| away_m >= least_m) {
                continue;
            }
            if field.cost_m(CellIndex { x: cell.x + dx, y: cell.y + dy }).is_some() {
                nearest = Some(away_m);
            }
        }
    }
    nearest
}
