//! `map.png`: the 2D map for people.

use super::canvas::{Canvas, Colour};
use crate::exploration::Places;
use crate::terrain::{CellClass, Grid};
use nalgebra::{Isometry3, Point2, Point3, Vector2};

/// What is drawn over the grid; everything in the map frame.
#[derive(Clone, Debug, Default)]
pub struct Overlay {
    /// Title line.
    pub title: String,
    /// Path of the robot.
    pub trajectory: Vec<Isometry3<f64>>,
    /// Victims with a label each.
    pub victims: Vec<(Point2<f64>, String)>,
    /// Frontiers that were left.
    pub frontiers: Vec<Point2<f64>>,
    /// Places where a sweep was taken.
    pub sweeps: Vec<Point2<f64>>,
    /// Rooms and doorways.
    pub places: Places,
}

/// Pixels along the longer side of the map proper.
const LONG_SIDE_PX: f64 = 1400.0;
const MARGIN_PX: f64 = 20.0;
const LEGEND_PX: usize = 96;

const LEGEND: &[(CellClass, &str)] = &[
    (CellClass::Free, "seen ground"),
    (CellClass::Assumed, "assumed ground"),
    (CellClass::Occupied, "obstacle"),
    (CellClass::TooSteep, "too steep"),
    (CellClass::DropOff, "drop-off"),
    (CellClass::Suspect, "edge suspected"),
    (CellClass::OtherLevel, "other level"),
    (CellClass::FlatFree, "free at laser height"),
    (CellClass::Unknown, "unknown"),
];

const PATH: Colour = Colour::rgb(0, 90, 220);
const START: Colour = Colour::rgb(0, 120, 40);
const VICTIM: Colour = Colour::rgb(200, 0, 0);
const ROOM: Colour = Colour::rgb(0, 110, 110);
const FRONTIER: Colour = Colour::rgb(150, 0, 160);

/// The colour under which a class is drawn. Drop-offs are the loudest; no two differ by hue alone.
pub fn class_colour(class: CellClass) -> Colour {
    match class {
        CellClass::Unknown => Colour::rgb(112, 122, 140),
        CellClass::Free => Colour::rgb(250, 250, 248),
        CellClass::Assumed => Colour::rgb(214, 228, 240),
        CellClass::Occupied => Colour::rgb(20, 24, 40),
        CellClass::TooSteep => Colour::rgb(150, 100, 30),
        CellClass::DropOff => Colour::rgb(230, 0, 30),
        CellClass::Suspect => Colour::rgb(255, 170, 80),
        CellClass::OtherLevel => Colour::rgb(190, 180, 205),
        CellClass::FlatFree => Colour::rgb(232, 240, 226),
    }
}

/// Draws the known part of the grid with a metre's border, y up.
pub fn draw(grid: &Grid, overlay: &Overlay) -> Canvas {
    let view = View::of(grid, overlay);
    let mut canvas = Canvas::new(view.width_px(), view.height_px() + LEGEND_PX, Colour::WHITE);
    canvas.rectangle_fill(
        MARGIN_PX,
        MARGIN_PX,
        view.width_px() as f64 - 2.0 * MARGIN_PX,
        view.height_px() as f64 - 2.0 * MARGIN_PX,
        class_colour(CellClass::Unknown),
    );
    let half = 0.5 * grid.cell_m() * view.scale;
    for (cell, what) in grid.iter().filter(|(_, what)| what.class != CellClass::Unknown) {
        // Whole pixels from edge to edge: neighbours meet without a seam.
        let centre = view.pixel(grid.centre(cell));
        let (left, right) = ((centre.x - half).round(), (centre.x + half).round());
        let (top, bottom) = ((centre.y - half).round(), (centre.y + half).round());
        let colour = class_colour(what.class);
        canvas.rectangle_fill(left, top, (right - left).max(1.0), (bottom - top).max(1.0), colour);
    }
    draw_metre_grid(&mut canvas, &view);
    draw_overlay(&mut canvas, &view, overlay);
    draw_legend(&mut canvas, &view, overlay);
    canvas
}

/// The part of the map that is drawn and its scale.
struct View {
    low: Point2<f64>,
    high: Point2<f64>,
    /// Pixels per metre.
    scale: f64,
}

impl View {
    fn of(grid: &Grid, overlay: &Overlay) -> Self {
        let mut low = Point2::new(f64::INFINITY, f64::INFINITY);
        let mut high = -low;
        let known = grid.iter().filter(|(_, what)| what.class != CellClass::Unknown);
        let cells = known.map(|(cell, _)| grid.centre(cell));
        let track = overlay.trajectory.iter().map(|pose| pose.translation.vector.xy().into());
        for p in cells.chain(track) {
            low = low.inf(&p);
            high = high.sup(&p);
        }
        if !low.x.is_finite() {
            (low, high) = (Point2::new(-1.0, -1.0), Point2::new(1.0, 1.0));
        }
        let border = Vector2::new(1.0, 1.0);
        let (low, high) = (low - border, high + border);
        let scale = (LONG_SIDE_PX / (high.x - low.x).max(high.y - low.y)).min(120.0);
        Self { low, high, scale }
    }

    fn width_px(&self) -> usize {
        (((self.high.x - self.low.x) * self.scale + 2.0 * MARGIN_PX).ceil() as usize).max(760)
    }

    fn height_px(&self) -> usize {
        ((self.high.y - self.low.y) * self.scale + 2.0 * MARGIN_PX).ceil() as usize
    }

    fn pixel(&self, p: Point2<f64>) -> Point2<f64> {
        Point2::new(
            MARGIN_PX + (p.x - self.low.x) * self.scale,
            MARGIN_PX + (self.high.y - p.y) * self.scale,
        )
    }
}

fn draw_metre_grid(canvas: &mut Canvas, view: &View) {
    let ink = |metre: i64| Colour::rgb(60, 70, 90).with_alpha(if metre % 5 == 0 { 64 } else { 26 });
    for x in view.low.x.ceil() as i64..=view.high.x.floor() as i64 {
        let top = view.pixel(Point2::new(x as f64, view.high.y));
        let bottom = view.pixel(Point2::new(x as f64, view.low.y));
        canvas.line(top, bottom, 1.0, ink(x));
        if x % 5 == 0 {
            canvas.text(bottom.x + 2.0, bottom.y - 9.0, 1, &format!("{x}"), Colour::BLACK);
        }
    }
    for y in view.low.y.ceil() as i64..=view.high.y.floor() as i64 {
        let left = view.pixel(Point2::new(view.low.x, y as f64));
        let right = view.pixel(Point2::new(view.high.x, y as f64));
        canvas.line(left, right, 1.0, ink(y));
        if y % 5 == 0 {
            canvas.text(left.x + 2.0, left.y + 2.0, 1, &format!("{y}"), Colour::BLACK);
        }
    }
}

fn draw_overlay(canvas: &mut Canvas, view: &View, overlay: &Overlay) {
    let at = |pose: &Isometry3<f64>| view.pixel(pose.translation.vector.xy().into());
    let track: Vec<_> = overlay.trajectory.iter().map(at).collect();
    canvas.polyline(&track, 2.0, PATH);
    for place in &overlay.sweeps {
        canvas.disc(view.pixel(*place), 3.5, PATH);
    }
    for room in &overlay.places.rooms {
        let label = format!("room {} ({:.0} m2)", room.id, room.area_m2);
        let p = view.pixel(room.middle);
        canvas.text(p.x - 0.5 * Canvas::text_width(1, &label), p.y - 4.0, 1, &label, ROOM);
    }
    for doorway in &overlay.places.doorways {
        let (p, half) = (view.pixel(doorway.middle), 0.12 * view.scale);
        let corners = [(0.0, -half), (half, 0.0), (0.0, half), (-half, 0.0)];
        canvas.polygon_fill(&corners.map(|(x, y)| Point2::new(p.x + x, p.y + y)), ROOM);
    }
    for frontier in &overlay.frontiers {
        canvas.circle(view.pixel(*frontier), 4.0, 1.5, FRONTIER);
    }
    for (place, label) in &overlay.victims {
        let p = view.pixel(*place);
        let arm = 0.25 * view.scale;
        let (falling, rising) = (Vector2::new(arm, arm), Vector2::new(arm, -arm));
        canvas.line(p - falling, p + falling, 3.0, VICTIM);
        canvas.line(p - rising, p + rising, 3.0, VICTIM);
        canvas.text(p.x + arm + 3.0, p.y - 4.0, 1, label, VICTIM);
    }
    if let (Some(first), Some(last)) = (overlay.trajectory.first(), overlay.trajectory.last()) {
        canvas.circle(at(first), 6.0, 2.0, START);
        let corners = [(0.26, 0.0), (-0.26, 0.25), (-0.26, -0.25)]
            .map(|(x, y)| view.pixel((last * Point3::new(x, y, 0.0)).xy()));
        canvas.polygon_fill(&corners, PATH);
    }
}

fn draw_legend(canvas: &mut Canvas, view: &View, overlay: &Overlay) {
    let top = view.height_px() as f64;
    canvas.text(MARGIN_PX, 5.0, 1, &overlay.title, Colour::BLACK);
    for (i, (class, name)) in LEGEND.iter().enumerate() {
        let x = MARGIN_PX + 150.0 * (i % 5) as f64;
        let y = top + 16.0 * (i / 5) as f64;
        canvas.rectangle_fill(x, y, 12.0, 12.0, Colour::BLACK);
        canvas.rectangle_fill(x + 1.0, y + 1.0, 10.0, 10.0, class_colour(*class));
        canvas.text(x + 17.0, y + 3.0, 1, name, Colour::BLACK);
    }
    let y = top + 38.0;
    let marks = "blue: path, dots are sweeps; green ring: start; purple rings: frontiers left; \
                 red cross: victim; teal diamond: doorway";
    canvas.text(MARGIN_PX, y, 1, marks, Colour::BLACK);
    // The longest of 1, 2, 5 and 10 m that fits a quarter of the width.
    let room_m = 0.25 * view.width_px() as f64 / view.scale;
    let metres = [10.0, 5.0, 2.0].into_iter().find(|m| *m <= room_m).unwrap_or(1.0);
    let (left, right) = (MARGIN_PX, MARGIN_PX + metres * view.scale);
    let y = y + 24.0;
    canvas.line(Point2::new(left, y), Point2::new(right, y), 2.0, Colour::BLACK);
    for x in [left, right] {
        canvas.line(Point2::new(x, y - 5.0), Point2::new(x, y + 5.0), 2.0, Colour::BLACK);
    }
    canvas.text(right + 8.0, y - 4.0, 1, &format!("{metres} m"), Colour::BLACK);
}
