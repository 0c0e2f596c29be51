//! The paper's figure 2: prediction above, update below, for each step of Table I.

use super::table1;
use crate::export::canvas::{Canvas, Colour};
use crate::export::map_scene::{add_path, add_robot};
use crate::export::scene3d::{Camera, Scene};
use crate::mapping::Observation;
use nalgebra::{Isometry3, Point3, Vector3};

const PANEL: (usize, usize) = (420, 300);
const TITLE_HEIGHT: usize = 24;

const MAP_BLUE: Colour = Colour::rgb(25, 40, 130);
const OBSERVED_BLUE: Colour = Colour::rgb(110, 190, 245);
const ODOMETRY_BROWN: Colour = Colour::rgb(140, 90, 40);
const CORRECTED_RED: Colour = Colour::rgb(215, 30, 30);

/// The picture: light blue what is observed, dark blue the map, brown the odometry's path, red the
/// corrected one.
pub fn picture() -> Canvas {
    let mut panels: Vec<(usize, bool, Canvas)> = Vec::new();
    let mut odometry_path = vec![Isometry3::identity()];
    let mut corrected_path = vec![Isometry3::identity()];
    table1::paper_mode(|stage| {
        if stage.k == 0 {
            return;
        }
        if stage.updated {
            corrected_path.pop();
        } else {
            odometry_path.push(stage.odometry);
        }
        corrected_path.push(*stage.filter.world_from_robot());
        panels.push((stage.k, stage.updated, panel(&stage, &odometry_path, &corrected_path)));
    });
    let steps = panels.len() / 2;
    let mut sheet =
        Canvas::new(steps * PANEL.0, 2 * (PANEL.1 + TITLE_HEIGHT) + TITLE_HEIGHT, Colour::WHITE);
    for (k, updated, picture) in panels {
        let (x, y) = ((k - 1) * PANEL.0, usize::from(updated) * (PANEL.1 + TITLE_HEIGHT));
        let title = format!("k = {k}, {}", if updated { "update" } else { "prediction" });
        sheet.text(x as f64 + 8.0, y as f64 + 7.0, 2, &title, Colour::BLACK);
        sheet.paste(x, y + TITLE_HEIGHT, &picture);
    }
    let key = [
        ("map", MAP_BLUE),
        ("observed", OBSERVED_BLUE),
        ("odometry", ODOMETRY_BROWN),
        ("corrected", CORRECTED_RED),
    ];
    let y = (2 * (PANEL.1 + TITLE_HEIGHT)) as f64 + 5.0;
    for (i, (name, colour)) in key.into_iter().enumerate() {
        let x = 12.0 + 160.0 * i as f64;
        sheet.rectangle_fill(x, y, 22.0, 14.0, colour);
        sheet.text(x + 30.0, y, 2, name, Colour::BLACK);
    }
    sheet
}

fn panel(
    stage: &table1::Stage<'_>,
    odometry_path: &[Isometry3<f64>],
    corrected_path: &[Isometry3<f64>],
) -> Canvas {
    let mut scene = Scene::new();
    for landmark in stage.filter.landmarks() {
        let corners: Vec<_> = landmark.hull_points().collect();
        scene.polygon(&corners, MAP_BLUE.with_alpha(110));
        scene.outline(&corners, 2.0, MAP_BLUE);
    }
    let pose = stage.filter.world_from_robot();
    for observation in stage.observations {
        let corners: Vec<_> = observed_corners(observation, pose);
        scene.polygon(&corners, OBSERVED_BLUE.with_alpha(110));
        scene.outline(&corners, 2.0, OBSERVED_BLUE);
    }
    add_path(&mut scene, odometry_path, 3.0, ODOMETRY_BROWN);
    add_path(&mut scene, corrected_path, 3.0, CORRECTED_RED);
    add_robot(&mut scene, pose, &Vector3::new(0.6, 0.5, 0.3), Colour::rgb(200, 200, 60));
    let camera =
        Camera::around(Point3::new(0.5, -1.5, -1.2), Point3::new(9.5, 3.0, 1.2), -2.2, 0.62);
    scene.render(&camera, PANEL.0, PANEL.1, Colour::WHITE)
}

fn observed_corners(observation: &Observation, pose: &Isometry3<f64>) -> Vec<Point3<f64>> {
    observation.hull_points().map(|p| pose * p).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_has_a_panel_for_each_step_and_stage() {
        let sheet = picture();
        assert_eq!(sheet.width(), 4 * PANEL.0);
        let shows = |x: usize, y: usize, colour: Colour| {
            (x..x + PANEL.0).any(|x| {
                (y..y + PANEL.1).any(|y| {
                    sheet.pixel(x, y).is_some_and(|pixel| {
                        pixel.red.abs_diff(colour.red) < 12
                            && pixel.green.abs_diff(colour.green) < 12
                            && pixel.blue.abs_diff(colour.blue) < 12
                    })
                })
            })
        };
        for column in 0..4 {
            for row in 0..2 {
                let (x, y) = (column * PANEL.0, TITLE_HEIGHT + row * (PANEL.1 + TITLE_HEIGHT));
                assert!(shows(x, y, ODOMETRY_BROWN) && shows(x, y, CORRECTED_RED));
            }
        }
    }
}
