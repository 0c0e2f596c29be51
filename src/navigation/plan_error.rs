//! Why there is no path.

use crate::terrain::{CellClass, CellIndex};
use serde::{Deserialize, Serialize};

/// What closed the way, counted in cells along the border of what could be reached.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Barriers {
    /// Obstacles.
    pub obstacle: u32,
    /// Drop-offs, proven or suspected.
    pub edge: u32,
    /// Ground that is too steep, or of another level.
    pub steep: u32,
    /// Ground that was not seen.
    pub unknown: u32,
    /// Seen ground on which the robot does not fit between what is beside it.
    pub narrow: u32,
}

impl std::fmt::Display for Barriers {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let kinds = [
            (self.obstacle, "obstacles"),
            (self.edge, "drop-offs"),
            (self.steep, "steep ground or other levels"),
            (self.unknown, "unseen ground"),
            (self.narrow, "gaps too narrow"),
        ];
        let mut found: Vec<_> = kinds.into_iter().filter(|(count, _)| *count > 0).collect();
        // Most frequent first; the sort is stable, so equal counts keep the order above.
        found.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
        if found.is_empty() {
            return f.write_str("nothing");
        }
        for (index, (count, name)) in found.iter().enumerate() {
            let separator = if index == 0 { "" } else { ", " };
            write!(f, "{separator}{name} ({count} cells)")?;
        }
        Ok(())
    }
}

/// Why there is no path.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Serialize, Deserialize)]
pub enum PlanError {
    /// The robot's own cell cannot be driven from.
    #[error("start cell ({}, {}) is {class:?} with {room_m:.2} m of room", cell.x, cell.y)]
    StartBlocked {
        /// The cell.
        cell: CellIndex,
        /// What it is.
        class: CellClass,
        /// Room there.
        room_m: f64,
    },
    /// Nothing is known of the goal's ground.
    #[error("goal cell ({}, {}) was never seen", .0.x, .0.y)]
    GoalUnknown(CellIndex),
    /// The goal is known, and not a place to stand.
    #[error("goal cell ({}, {}) is {class:?}", cell.x, cell.y)]
    GoalBlocked {
        /// The cell.
        cell: CellIndex,
        /// What it is.
        class: CellClass,
    },
    /// The robot does not fit at the goal.
    #[error("goal cell ({}, {}) has {room_m:.2} m of room, the robot needs {needed_m:.2} m", cell.x, cell.y)]
    GoalTight {
        /// The cell.
        cell: CellIndex,
        /// Room there.
        room_m: f64,
        /// Room that the robot's inscribed circle needs.
        needed_m: f64,
    },
    /// Everything within reach was searched.
    #[error("no path to ({}, {}): {reached} cells reached, closed by {by}", goal.x, goal.y)]
    Unreachable {
        /// The goal's cell.
        goal: CellIndex,
        /// Cells that were reached.
        reached: usize,
        /// What closed them in.
        by: Barriers,
    },
}
