//! Convex polygons in the plane: Jarvis's hull, area, clipping and gaps.
//!
//! Polygons are vertex lists in counter-clockwise order, without a repeated first vertex.

use nalgebra::Point2;

/// Twice the signed area of the triangle `a b c`; positive when it turns left.
fn cross(a: &Point2<f64>, b: &Point2<f64>, c: &Point2<f64>) -> f64 {
    (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)
}

fn distance_squared(a: &Point2<f64>, b: &Point2<f64>) -> f64 {
    (b - a).norm_squared()
}

/// The convex hull of `points`, counter-clockwise from the lowest (then leftmost) point.
///
/// Jarvis's march (1973): from each hull vertex the next is the point with no other to its right;
/// of collinear candidates the farthest wins, so no vertex lies inside an edge. Costs O(n h).
/// Fewer than three distinct or only collinear points have no hull: the result is empty.
/// Points that are not finite are left out.
pub fn convex_hull(points: &[Point2<f64>]) -> Vec<Point2<f64>> {
    let mut candidates: Vec<Point2<f64>> =
        points.iter().filter(|p| p.x.is_finite() && p.y.is_finite()).copied().collect();
    candidates.sort_by(|a, b| a.y.total_cmp(&b.y).then(a.x.total_cmp(&b.x)));
    candidates.dedup();
    if candidates.len() < 3 {
        return Vec::new();
    }
    let start = 0;
    let mut hull = vec![candidates[start]];
    let mut current = start;
    // Rounding can hide the start from the march; a hull has at most n vertices, so n steps end it.
    for _ in 0..candidates.len() {
        let mut next = if current == 0 { 1 } else { 0 };
        for (i, point) in candidates.iter().enumerate() {
            if i == current || i == next {
                continue;
            }
            let turn = cross(&candidates[current], &candidates[next], point);
            let farther = distance_squared(&candidates[current], point)
                > distance_squared(&candidates[current], &candidates[next]);
            if turn < 0.0 || (turn == 0.0 && farther) {
                next = i;
            }
        }
        if next == start {
            break;
        }
        hull.push(candidates[next]);
        current = next;
    }
    if hull.len() < 3 || polygon_area(&hull) <= 0.0 {
        return Vec::new();
    }
    hull
}

/// Area of a simple polygon in square metres, positive when it runs counter-clockwise.
pub fn polygon_area(polygon: &[Point2<f64>]) -> f64 {
    let Some(first) = polygon.first() else { return 0.0 };
    // Relative to the first vertex: far from the origin the plain shoelace sum cancels.
    0.5 * polygon.windows(2).map(|edge| cross(first, &edge[0], &edge[1])).sum::<f64>()
}

/// Centre of area of a convex polygon; `None` where it has no area.
pub fn polygon_centroid(polygon: &[Point2<f64>]) -> Option<Point2<f64>> {
    let first = polygon.first()?;
    let mut twice_area = 0.0;
    let mut moment = nalgebra::Vector2::zeros();
    for edge in polygon.windows(2) {
        let weight = cross(first, &edge[0], &edge[1]);
        twice_area += weight;
        moment += ((edge[0] - first) + (edge[1] - first)) * weight;
    }
    (twice_area.abs() > 0.0).then(|| first + moment / (3.0 * twice_area))
}

/// The edges of a polygon in order, the closing one last.
fn edges(polygon: &[Point2<f64>]) -> impl Iterator<Item = (&Point2<f64>, &Point2<f64>)> {
    polygon.iter().zip(polygon.iter().skip(1).chain(polygon.first()))
}

/// Whether `point` lies inside or on the border of a counter-clockwise convex polygon.
pub fn contains_point(polygon: &[Point2<f64>], point: &Point2<f64>) -> bool {
    polygon.len() >= 3 && edges(polygon).all(|(a, b)| cross(a, b, point) >= 0.0)
}

/// The intersection of two counter-clockwise convex polygons (Sutherland-Hodgman); empty when they
/// do not overlap.
pub fn clip_convex(subject: &[Point2<f64>], clip: &[Point2<f64>]) -> Vec<Point2<f64>> {
    let mut polygon = subject.to_vec();
    for (a, b) in edges(clip) {
        if polygon.is_empty() {
            break;
        }
        let mut kept = Vec::with_capacity(polygon.len() + 1);
        for (p, q) in edges(&polygon) {
            let (side_p, side_q) = (cross(a, b, p), cross(a, b, q));
            if side_p >= 0.0 {
                kept.push(*p);
            }
            if (side_p > 0.0 && side_q < 0.0) || (side_p < 0.0 && side_q > 0.0) {
                kept.push(p + (q - p) * (side_p / (side_p - side_q)));
            }
        }
        polygon = kept;
    }
    if polygon.len() < 3 || polygon_area(&polygon) <= 0.0 { Vec::new() } else { polygon }
}

/// Distance between two convex polygons in metres, zero when they touch or overlap; infinite when
/// either is empty.
pub fn convex_gap_m(a: &[Point2<f64>], b: &[Point2<f64>]) -> f64 {
    if a.is_empty() || b.is_empty() {
        return f64::INFINITY;
    }
    if a.iter().any(|p| contains_point(b, p)) || b.iter().any(|p| contains_point(a, p)) {
        return 0.0;
    }
    if !clip_convex(a, b).is_empty() {
        return 0.0;
    }
    let one_way = |from: &[Point2<f64>], to: &[Point2<f64>]| {
        from.iter()
            .flat_map(|p| edges(to).map(move |(a, b)| point_segment_m(p, a, b)))
            .fold(f64::INFINITY, f64::min)
    };
    one_way(a, b).min(one_way(b, a))
}

fn point_segment_m(p: &Point2<f64>, a: &Point2<f64>, b: &Point2<f64>) -> f64 {
    let ab = b - a;
    let length_squared = ab.norm_squared();
    let t = if length_squared > 0.0 {
        ((p - a).dot(&ab) / length_squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (p - (a + ab * t)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn square(x: f64, y: f64, side: f64) -> Vec<Point2<f64>> {
        vec![
            Point2::new(x, y),
            Point2::new(x + side, y),
            Point2::new(x + side, y + side),
            Point2::new(x, y + side),
        ]
    }

    #[test]
    fn collinear_and_duplicate_points_have_no_hull() {
        let line: Vec<_> = (0..5).map(|i| Point2::new(f64::from(i), 2.0 * f64::from(i))).collect();
        assert!(convex_hull(&line).is_empty());
        assert!(convex_hull(&[Point2::new(1.0, 1.0); 9]).is_empty());
        assert!(convex_hull(&[]).is_empty());
    }

    #[test]
    fn hull_of_a_grid_is_its_four_corners() {
        let grid: Vec<_> = (0..6)
            .flat_map(|i| (0..4).map(move |j| Point2::new(f64::from(i), f64::from(j))))
            .collect();
        assert_eq!(convex_hull(&grid).len(), 4);
        assert_eq!(polygon_area(&convex_hull(&grid)), 15.0);
    }

    #[test]
    fn clip_gives_the_shared_square() {
        let shared = clip_convex(&square(0.0, 0.0, 2.0), &square(1.0, 1.0, 2.0));
        assert!((polygon_area(&shared) - 1.0).abs() < 1e-12);
        assert!(clip_convex(&square(0.0, 0.0, 1.0), &square(3.0, 0.0, 1.0)).is_empty());
    }

    #[test]
    fn gap_is_the_shortest_way_between() {
        assert!((convex_gap_m(&square(0.0, 0.0, 1.0), &square(3.0, 0.5, 1.0)) - 2.0).abs() < 1e-12);
        assert_eq!(convex_gap_m(&square(0.0, 0.0, 2.0), &square(1.0, 1.0, 2.0)), 0.0);
        assert_eq!(convex_gap_m(&square(0.0, 0.0, 9.0), &square(1.0, 1.0, 2.0)), 0.0);
    }

    #[test]
    fn centroid_of_a_shifted_square() {
        let centre = polygon_centroid(&square(100.0, -50.0, 2.0)).unwrap();
        assert!((centre - Point2::new(101.0, -49.0)).norm() < 1e-12);
    }

    proptest! {
        #[test]
        fn every_point_is_inside_its_hull(raw in prop::collection::vec((-50.0..50.0, -50.0..50.0), 3..60)) {
            let points: Vec<_> = raw.iter().map(|&(x, y)| Point2::new(x, y)).collect();
            let hull = convex_hull(&points);
            prop_assume!(!hull.is_empty());
            for p in &points {
                let inside = (0..hull.len()).all(|i| cross(&hull[i], &hull[(i + 1) % hull.len()], p) >= -1e-9);
                prop_assert!(inside);
            }
        }
    }
}
