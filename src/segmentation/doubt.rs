//! Regions that their plane does not explain are parted into what a plane explains and the rest.
//!
//! Sticks and borders are settled by planes as they were known at the time, and only cells at a border
//! compete. So a region can end with a step inside it, with the facets of a curved surface that was
//! none after all, or with far readings. Its least-squares plane is then no one's: which readings lie
//! within any gate about it is chance. So the plane that most of the region lies on is sought first.

use super::components::Components;
use super::field::Field;
use super::fit::LEAST_COSINE;
use super::moments::Moments;
use super::morphology::neighbours8;

/// Squared error, in units of the noise, at which a cell is left out if as many of its neighbours are
/// as are not; each of the eight counts one.
const UNEXPLAINED: f32 = 12.0;
const VOTES: f32 = 8.0;
/// Places of a region at which a plane is guessed.
const GUESSES: usize = 16;
/// Lanes and steps from the middle of such a place to its side, at least.
const REACH: usize = 2;
/// Fewest cells of a place.
const FEWEST: f64 = 6.0;
/// About how many cells tell how well a plane explains a region, and rounds in which it is improved.
const TRIAL_CELLS: usize = 250;
const ROUNDS: usize = 2;
/// Most times that cells are looked at.
const SWEEPS: usize = 16;
/// Median of the squared error of one standard deviation, and the most that surfaces and sensors which
/// are not perfect may enlarge it.
const MEDIAN_SQUARE: f32 = 0.455;
const MOST_ENLARGED: f32 = 4.0;

/// Buffers of the parting.
#[derive(Clone, Debug, Default)]
pub(super) struct Doubts {
    /// Labels with those of the parts, which come after all others.
    pub labels: Vec<u32>,
    /// Plane `q · p = 1` of each part.
    pub planes: Vec<[f64; 3]>,
    cells: Vec<u32>,
    /// Cells that their neighbours may leave out or keep, with their squared errors.
    open: Vec<(u32, f32)>,
    out: Vec<bool>,
    trial: Vec<u32>,
    squares: Vec<f32>,
}

impl Doubts {
    /// Forgets the parts of an earlier scan.
    pub fn start(&mut self) {
        self.labels.clear();
        self.planes.clear();
    }

    /// Parts a component whose plane was found to be `q`: what the plane explains that explains most
    /// of it gets a label of its own from `first` on, which all of `labels` of returns are below, and so does the
    /// rest where it has at least `fewest` cells. Returns whether anything has changed.
    pub fn part(
        &mut self,
        field: &Field,
        components: &Components,
        component: usize,
        q: [f64; 3],
        (labels, first, fewest): (&[u32], usize, usize),
    ) -> bool {
        self.cells.clear();
        self.cells.extend(components.cells(component).map(|cell| cell as u32));
        self.trial.clear();
        let stride = self.cells.len().div_ceil(TRIAL_CELLS).max(1);
        self.trial.extend(self.cells.iter().step_by(stride));
        let (best, better) = self.best_plane(field, components, component, q);
        let scale = self.scale(field, &best);
        let left_out = self.leave_out(field, labels, &best, scale);
        if left_out == 0 && !better {
            return false;
        }
        // Most scans have no region that is parted.
        if self.labels.is_empty() {
            self.labels.extend_from_slice(labels);
        }
        let kept = (first + self.planes.len()) as u32;
        self.planes.push(best);
        let rest = if left_out < fewest {
            0
        } else {
            let mut moments = Moments::default();
            for &cell in self.cells.iter().filter(|&&cell| self.out[cell as usize]) {
                moments.add_point(field.point(cell as usize), field.weight(cell as usize));
            }
            self.planes.push(moments.solve());
            kept + 1
        };
        for &cell in &self.cells {
            self.labels[cell as usize] = if self.out[cell as usize] { rest } else { kept };
        }
        true
    }

    /// The plane that explains most of the cells, out of the given one and guesses at places of the
    /// region, and whether it is another than the given one.
    fn best_plane(
        &mut self,
        field: &Field,
        components: &Components,
        component: usize,
        q: [f64; 3],
    ) -> ([f64; 3], bool) {
        let cost = |q: &[f64; 3], trial: &[u32]| -> f32 {
            trial.iter().map(|&cell| square(field, q, cell as usize).min(UNEXPLAINED)).sum()
        };
        let given = cost(&q, &self.trial);
        let mut best = (given, q);
        let aspect = ((field.across_rad / field.along_rad).round() as usize).clamp(1, 8);
        for k in 0..GUESSES {
            let middle = self.cells[(2 * k + 1) * self.cells.len() / (2 * GUESSES)] as usize;
            let (step, lane) = (middle / field.lanes, middle % field.lanes);
            let reach = REACH * aspect;
            let mut moments = Moments::default();
            for s in step.saturating_sub(reach)..=(step + reach).min(field.steps - 1) {
                for l in lane.saturating_sub(REACH)..=(lane + REACH).min(field.lanes - 1) {
                    let cell = s * field.lanes + l;
                    if components.of(cell) == Some(component) {
                        moments.add_point(field.point(cell), field.weight(cell));
                    }
                }
            }
            for _ in 0..=ROUNDS {
                if moments.n < FEWEST {
                    break;
                }
                let guess = moments.solve();
                let found = cost(&guess, &self.trial);
                if found < best.0 {
                    best = (found, guess);
                }
                moments = Moments::default();
                for &cell in &self.trial {
                    if square(field, &guess, cell as usize) < UNEXPLAINED {
                        moments.add_point(field.point(cell as usize), field.weight(cell as usize));
                    }
                }
            }
        }
        // A plane through some of the cells is a little better than the given one by chance.
        let better = best.0 < given - UNEXPLAINED;
        (if better { best.1 } else { q }, better)
    }

    /// What the errors of the half that a plane explains best are enlarged by.
    fn scale(&mut self, field: &Field, q: &[f64; 3]) -> f32 {
        self.squares.clear();
        self.squares.extend(self.trial.iter().map(|&cell| square(field, q, cell as usize)));
        let middle = self.squares.len() / 2;
        let median = *self.squares.select_nth_unstable_by(middle, f32::total_cmp).1;
        (median / MEDIAN_SQUARE).clamp(1.0, MOST_ENLARGED)
    }

    /// Marks the cells that a plane does not explain, each in agreement with its neighbours; returns
    /// how many these are.
    fn leave_out(&mut self, field: &Field, labels: &[u32], q: &[f64; 3], scale: f32) -> usize {
        // Those of other components beside it have other labels, now too if they were parted.
        let labels = if self.labels.is_empty() { labels } else { &self.labels };
        self.out.resize(field.len(), false);
        self.open.clear();
        let mut count = 0;
        for &cell in &self.cells {
            let error = square(field, q, cell as usize) / scale;
            // Groups first: their neighbours would hold each of them.
            self.out[cell as usize] = error > UNEXPLAINED;
            count += usize::from(error > UNEXPLAINED);
            if error > UNEXPLAINED - VOTES {
                self.open.push((cell, error));
            }
        }
        for _ in 0..SWEEPS {
            let mut changed = false;
            for &(cell, error) in &self.open {
                let mut votes = 0.0;
                for n in neighbours8(cell as usize, field.lanes, field.len()) {
                    if labels[n] == labels[cell as usize] {
                        votes += if self.out[n] { -1.0 } else { 1.0 };
                    }
                }
                let out = error > UNEXPLAINED + votes;
                if out != self.out[cell as usize] {
                    self.out[cell as usize] = out;
                    count = if out { count + 1 } else { count - 1 };
                    changed = true;
                }
            }
            if !changed {
                break;
            }
        }
        count
    }
}

/// Squared error of a cell on a plane, in units of its noise.
pub(super) fn square(field: &Field, q: &[f64; 3], cell: usize) -> f32 {
    let [x, y, z] = q.map(|v| v as f32);
    let length = (x * x + y * y + z * z).sqrt();
    let error = x * field.x[cell] + y * field.y[cell] + z * field.z[cell] - 1.0;
    let grazing = (field.inverse[cell] / (length * LEAST_COSINE as f32)).min(1.0);
    let error = error * field.gain[cell] * grazing;
    error * error
}
