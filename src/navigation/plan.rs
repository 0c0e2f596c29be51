//! The cheapest path over a grid, and the cost of reaching every cell.

use super::Pose2;
use super::cost_map::{BEST, CostMap, DEAREST, DIAGONAL, STRAIGHT};
use super::path::Path;
use super::plan_error::{Barriers, PlanError};
use crate::terrain::{CellClass, CellIndex, Grid};
use nalgebra::Point2;
use serde::{Deserialize, Serialize};

/// Length of the ring of buckets; no edge is longer.
const BUCKETS: usize = 2048;

/// Searches cost maps. Keeps its work arrays from call to call: they are stamped with a generation,
/// so that a search costs nothing for cells it does not touch.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Planner {
    #[serde(skip)]
    scratch: Scratch,
}

impl PartialEq for Planner {
    /// Planners hold no state that outlives a search.
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

#[derive(Clone, Debug, Default)]
struct Scratch {
    generation: u32,
    nodes: Vec<Node>,
    buckets: Vec<Vec<u32>>,
}

/// A cell in the search: valid if stamped with the search's generation.
#[derive(Clone, Copy, Debug, Default)]
struct Node {
    generation: u32,
    cost: u32,
    parent: u32,
    closed: bool,
}

impl Scratch {
    fn begin(&mut self, cells: usize) {
        if self.nodes.len() < cells {
            self.nodes = vec![Node::default(); cells];
            self.generation = 0;
        }
        if self.generation == u32::MAX {
            self.nodes.fill(Node::default());
            self.generation = 0;
        }
        self.generation += 1;
        self.buckets.resize(BUCKETS, Vec::new());
        self.buckets.iter_mut().for_each(Vec::clear);
    }

    /// Lowers the cost of a cell, if that is news.
    #[inline]
    fn relax(&mut self, index: usize, cost: u32, parent: usize, key: u32) {
        let generation = self.generation;
        let node = &mut self.nodes[index];
        if node.generation == generation && node.cost <= cost {
            return;
        }
        *node = Node { generation, cost, parent: parent as u32, closed: false };
        self.buckets[key as usize % BUCKETS].push(index as u32);
    }

    fn is_closed(&self, index: usize) -> bool {
        let node = &self.nodes[index];
        node.generation == self.generation && node.closed
    }
}

/// Cost of the best way from one cell to every cell.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CostField {
    cell_m: f64,
    low: CellIndex,
    width: usize,
    costs: Vec<u32>,
}

impl CostField {
    /// Cost to reach a cell, in metres of best ground; `None` where there is no way.
    pub fn cost_m(&self, cell: CellIndex) -> Option<f64> {
        let (x, y) = (cell.x - self.low.x, cell.y - self.low.y);
        if x < 0 || y < 0 || x as usize >= self.width {
            return None;
        }
        let cost = *self.costs.get(y as usize * self.width + x as usize)?;
        (cost != u32::MAX).then(|| f64::from(cost) * self.cell_m / f64::from(BEST * STRAIGHT))
    }
}

impl Planner {
    /// The cheapest path from the robot to a goal cell's centre, smoothed where that costs nothing.
    ///
    /// A* over eight neighbours with octile distance. Equal paths are told apart by the order of the
    /// search, which is fixed.
    ///
    /// # Errors
    ///
    /// Says which end is blocked and by what, or what closes the reachable ground in.
    pub fn plan(
        &mut self,
        grid: &Grid,
        costs: &CostMap,
        start: &Pose2,
        goal: CellIndex,
    ) -> Result<Path, PlanError> {
        let from = grid.cell_of(start.x_m, start.y_m);
        if !costs.is_open(from) {
            let here = grid.get(from);
            let room_m = f64::from(here.room_m);
            return Err(PlanError::StartBlocked { cell: from, class: here.class, room_m });
        }
        if !costs.is_open(goal) {
            return Err(goal_error(grid, goal));
        }
        let cells = self.search(costs, from, goal).map_err(|reached| PlanError::Unreachable {
            goal,
            reached,
            by: self.barriers(grid, costs),
        })?;
        let mut points: Vec<Point2<f64>> =
            smooth(costs, &cells).into_iter().map(|cell| grid.centre(cell)).collect();
        // The robot stands somewhere in its cell; the path starts where it is.
        points[0] = start.point();
        Ok(Path::new(points))
    }

    /// The cells of the cheapest way, or how many cells were reached without finding one. Cost is
    /// the sum of the weights entered.
    ///
    /// # Errors
    ///
    /// The number of cells that can be reached, when the goal is not among them.
    pub fn search(
        &mut self,
        costs: &CostMap,
        from: CellIndex,
        goal: CellIndex,
    ) -> Result<Vec<CellIndex>, usize> {
        let (Some(start), Some(end)) = (costs.index(from), costs.index(goal)) else {
            return Err(0);
        };
        let width = costs.width;
        let (end_x, end_y) = ((end % width) as i32, (end / width) as i32);
        let rest = |index: usize| {
            let dx = ((index % width) as i32 - end_x).unsigned_abs();
            let dy = ((index / width) as i32 - end_y).unsigned_abs();
            BEST * (STRAIGHT * dx.max(dy) + (DIAGONAL - STRAIGHT) * dx.min(dy))
        };
        let reached = self.run(costs, start, rest, Some(end));
        if !self.scratch.is_closed(end) {
            return Err(reached);
        }
        let mut cells = vec![goal];
        let mut at = end;
        while at != start {
            at = self.scratch.nodes[at].parent as usize;
            cells.push(costs.cell_at(at));
        }
        cells.reverse();
        Ok(cells)
    }

    /// The cost of reaching every cell from one: Dijkstra over the whole map.
    pub fn field(&mut self, costs: &CostMap, from: CellIndex) -> CostField {
        let mut field = CostField {
            cell_m: costs.cell_m,
            low: costs.low,
            width: costs.width,
            costs: vec![u32::MAX; costs.weights.len()],
        };
        if let Some(start) = costs.index(from)
            && costs.weights[start] > 0
        {
            self.run(costs, start, |_| 0, None);
            let scratch = &self.scratch;
            for (cost, node) in field.costs.iter_mut().zip(&scratch.nodes) {
                if node.generation == scratch.generation && node.closed {
                    *cost = node.cost;
                }
            }
        }
        field
    }

    /// Cost of the best way found by the last search to a cell, in metres of best ground.
    pub fn cost_m(&self, costs: &CostMap, cell: CellIndex) -> Option<f64> {
        let index = costs.index(cell)?;
        self.scratch.is_closed(index).then(|| costs.metres(self.scratch.nodes[index].cost))
    }

    /// Best-first search with a ring of buckets: keys are small integers, and with a consistent
    /// estimate no key lies more than one dearest edge and its estimate ahead of the current one.
    fn run(
        &mut self,
        costs: &CostMap,
        start: usize,
        rest: impl Fn(usize) -> u32,
        goal: Option<usize>,
    ) -> usize {
        const {
            assert!(((DEAREST + BEST) * DIAGONAL) as usize <= BUCKETS, "keys fit the ring");
        }
        let scratch = &mut self.scratch;
        scratch.begin(costs.weights.len());
        let mut key = rest(start);
        scratch.relax(start, 0, start, key);
        let (mut reached, mut idle) = (0, 0);
        while idle < BUCKETS {
            let Some(index) = scratch.buckets[key as usize % BUCKETS].pop() else {
                key += 1;
                idle += 1;
                continue;
            };
            idle = 0;
            let at = index as usize;
            if scratch.nodes[at].closed {
                continue;
            }
            scratch.nodes[at].closed = true;
            reached += 1;
            if goal == Some(at) {
                break;
            }
            let cost = scratch.nodes[at].cost;
            costs.steps(at, |beside, step| {
                scratch.relax(beside, cost + step, at, cost + step + rest(beside));
            });
        }
        reached
    }

    /// What lies around the cells that the last search closed.
    fn barriers(&self, grid: &Grid, costs: &CostMap) -> Barriers {
        let mut by = Barriers::default();
        for index in 0..costs.weights.len() {
            if !self.scratch.is_closed(index) {
                continue;
            }
            let cell = costs.cell_at(index);
            for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                let beside = CellIndex { x: cell.x + dx, y: cell.y + dy };
                if costs.is_open(beside) {
                    continue;
                }
                match limiting(grid, beside) {
                    CellClass::Occupied => by.obstacle += 1,
                    CellClass::DropOff | CellClass::Suspect => by.edge += 1,
                    CellClass::TooSteep | CellClass::OtherLevel => by.steep += 1,
                    CellClass::Unknown | CellClass::FlatFree => by.unknown += 1,
                    CellClass::Free | CellClass::Assumed => by.narrow += 1,
                }
            }
        }
        by
    }
}

/// What takes the room from a cell: the most serious class within the robot's reach of it.
fn limiting(grid: &Grid, cell: CellIndex) -> CellClass {
    let reach = (grid.needed_room_m(cell).max(0.2) / grid.cell_m()).ceil() as i32 + 1;
    let (mut obstacle, mut other) = (0, None);
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let class = grid.get(CellIndex { x: cell.x + dx, y: cell.y + dy }).class;
            if class.is_edge() {
                return class;
            }
            if class == CellClass::Occupied {
                obstacle += 1;
            } else if !class.is_drivable() {
                other = Some(class);
            }
        }
    }
    if obstacle > 0 {
        // Drivable itself, yet too near to obstacles: the gap is the reason.
        let here = grid.get(cell).class;
        return if here.is_drivable() { here } else { CellClass::Occupied };
    }
    other.unwrap_or(CellClass::Free)
}

fn goal_error(grid: &Grid, goal: CellIndex) -> PlanError {
    let there = grid.get(goal);
    match there.class {
        CellClass::Unknown | CellClass::FlatFree => PlanError::GoalUnknown(goal),
        class if class.is_drivable() => PlanError::GoalTight {
            cell: goal,
            room_m: f64::from(there.room_m),
            needed_m: grid.needed_room_m(goal),
        },
        class => PlanError::GoalBlocked { cell: goal, class },
    }
}

/// Leaves out corners that a straight line over open cells replaces at no more cost.
fn smooth(costs: &CostMap, cells: &[CellIndex]) -> Vec<CellIndex> {
    let mut kept = vec![cells[0]];
    let mut from = 0;
    while from + 1 < cells.len() {
        // Doubling, then halving: the farthest reachable by a line, near enough, in few tries.
        let (mut good, mut step) = (from + 1, 2);
        while from + step < cells.len() && line_is_as_good(costs, &cells[from..=from + step]) {
            good = from + step;
            step *= 2;
        }
        let mut bad = (from + step).min(cells.len());
        while bad - good > 1 {
            let middle = good.midpoint(bad);
            if line_is_as_good(costs, &cells[from..=middle]) {
                good = middle;
            } else {
                bad = middle;
            }
        }
        kept.push(cells[good]);
        from = good;
    }
    kept
}

/// Whether the straight line between the ends of a stretch is open and costs no more than the
/// stretch itself, within a hundredth.
fn line_is_as_good(costs: &CostMap, stretch: &[CellIndex]) -> bool {
    let (a, b) = (stretch[0], stretch[stretch.len() - 1]);
    let mut along = 0;
    for pair in stretch.windows(2) {
        let diagonal = pair[0].x != pair[1].x && pair[0].y != pair[1].y;
        along += costs.weight(pair[1]) * if diagonal { DIAGONAL } else { STRAIGHT };
    }
    let (dx, dy) = (f64::from(b.x - a.x), f64::from(b.y - a.y));
    let length = dx.hypot(dy);
    let steps = (length * 3.0).ceil().max(1.0);
    let mut sum = 0.0;
    for step in 0..=steps as u32 {
        let t = f64::from(step) / steps;
        let cell = CellIndex { x: a.x + (dx * t).round() as i32, y: a.y + (dy * t).round() as i32 };
        let weight = costs.weight(cell);
        if weight == 0 {
            return false;
        }
        sum += f64::from(weight);
    }
    let straight = sum / (steps + 1.0) * length * f64::from(STRAIGHT);
    straight <= 1.01 * f64::from(along) + f64::from(STRAIGHT * BEST)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::cmp::Reverse;
    use std::collections::BinaryHeap;

    const LOW: CellIndex = CellIndex { x: -3, y: 7 };

    fn map(width: usize, weights: Vec<u8>) -> CostMap {
        CostMap::from_weights(0.1, LOW, width, weights)
    }

    /// The textbook search, with none of the planner's tricks.
    fn dijkstra(costs: &CostMap, start: usize) -> Vec<Option<u32>> {
        let mut best = vec![None; costs.weights.len()];
        let mut heap = BinaryHeap::from([Reverse((0_u32, start))]);
        while let Some(Reverse((cost, at))) = heap.pop() {
            if best[at].is_some() {
                continue;
            }
            best[at] = Some(cost);
            let (x, y) = ((at % costs.width) as i32, (at / costs.width) as i32);
            let open = |x: i32, y: i32| {
                x >= 0
                    && y >= 0
                    && (x as usize) < costs.width
                    && (y as usize) < costs.height
                    && costs.weights[y as usize * costs.width + x as usize] > 0
            };
            for dy in -1..=1 {
                for dx in -1..=1 {
                    if (dx, dy) == (0, 0)
                        || !open(x + dx, y + dy)
                        || !open(x + dx, y)
                        || !open(x, y + dy)
                    {
                        continue;
                    }
                    let beside = (y + dy) as usize * costs.width + (x + dx) as usize;
                    let factor = if dx != 0 && dy != 0 { DIAGONAL } else { STRAIGHT };
                    heap.push(Reverse((cost + factor * u32::from(costs.weights[beside]), beside)));
                }
            }
        }
        best
    }

    prop_compose! {
        fn any_map()(width in 2_usize..30, height in 2_usize..30)(
            weights in prop::collection::vec(
                prop_oneof![2 => Just(0_u8), 3 => Just(8_u8), 3 => 8_u8..=60],
                width * height,
            ),
            start in 0..width * height,
            goal in 0..width * height,
            width in Just(width),
        ) -> (CostMap, usize, usize) {
            let mut weights = weights;
            weights[start] = 8;
            weights[goal] = 8;
            (map(width, weights), start, goal)
        }
    }

    proptest! {
        #[test]
        fn a_star_costs_what_dijkstra_costs((costs, start, goal) in any_map()) {
            let oracle = dijkstra(&costs, start);
            let mut planner = Planner::default();
            // Twice, so that stale work arrays would show.
            for _ in 0..2 {
                let found = planner.search(&costs, costs.cell_at(start), costs.cell_at(goal));
                match oracle[goal] {
                    None => {
                        let reached = oracle.iter().flatten().count();
                        prop_assert_eq!(found, Err(reached));
                    }
                    Some(cost) => {
                        let cells = found.unwrap();
                        let mut sum = 0;
                        for pair in cells.windows(2) {
                            let (dx, dy) = (pair[1].x - pair[0].x, pair[1].y - pair[0].y);
                            prop_assert!(dx.abs() <= 1 && dy.abs() <= 1);
                            let factor = if dx != 0 && dy != 0 { DIAGONAL } else { STRAIGHT };
                            sum += factor * costs.weight(pair[1]);
                        }
                        prop_assert_eq!(sum, cost);
                        prop_assert!(
                            (planner.cost_m(&costs, costs.cell_at(goal)).unwrap()
                                - costs.metres(cost)).abs() < 1e-12
                        );
                    }
                }
            }
        }

        #[test]
        fn the_cost_field_is_dijkstra_everywhere((costs, start, _) in any_map()) {
            let oracle = dijkstra(&costs, start);
            let field = Planner::default().field(&costs, costs.cell_at(start));
            for (index, cost) in oracle.into_iter().enumerate() {
                let expected = cost.map(|cost| costs.metres(cost));
                prop_assert_eq!(field.cost_m(costs.cell_at(index)), expected);
            }
        }

        #[test]
        fn smoothing_touches_no_blocked_cell((costs, start, goal) in any_map()) {
            let mut planner = Planner::default();
            if let Ok(cells) = planner.search(&costs, costs.cell_at(start), costs.cell_at(goal)) {
                let corners = smooth(&costs, &cells);
                prop_assert_eq!(corners.first(), cells.first());
                prop_assert_eq!(corners.last(), cells.last());
                for pair in corners.windows(2) {
                    let (dx, dy) = (f64::from(pair[1].x - pair[0].x), f64::from(pair[1].y - pair[0].y));
                    for step in 0..=300 {
                        let t = f64::from(step) / 300.0;
                        let cell = CellIndex {
                            x: pair[0].x + (dx * t).round() as i32,
                            y: pair[0].y + (dy * t).round() as i32,
                        };
                        // The line is judged at thirds of a cell: it may clip a corner.
                        let clip = |u: f64| ((u - u.floor()) - 0.5).abs();
                        prop_assert!(
                            costs.is_open(cell) || clip(dx * t).min(clip(dy * t)) < 0.2
                        );
                    }
                }
            }
        }
    }
}
