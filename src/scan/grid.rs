use super::Rounding;
use nalgebra::{Point3, Vector3};

/// An organised cloud: `rows × columns` points in one frame whose origin is the viewpoint.
///
/// NaN marks a cell without a return. Nothing is said about the order of rows or columns: either
/// may run in either direction.
#[derive(Clone, Debug, PartialEq)]
pub struct PointGrid {
    rows: usize,
    columns: usize,
    points: Vec<[f32; 3]>,
    /// Empty where nothing is known.
    row_sigmas_rad: Vec<f32>,
    rounding: Option<Rounding>,
}

impl PointGrid {
    /// A grid of row-major `points` in metres.
    ///
    /// # Panics
    ///
    /// When the number of points is not `rows * columns`.
    pub fn new(rows: usize, columns: usize, points: Vec<[f32; 3]>) -> Self {
        assert_eq!(points.len(), rows * columns, "a grid has rows * columns points");
        Self { rows, columns, points, row_sigmas_rad: Vec::new(), rounding: None }
    }

    /// The grid with the standard deviation of each row's tilt about the y axis in radians, an error that
    /// all points of a row have in common.
    ///
    /// # Panics
    ///
    /// When there is not one for each row.
    #[must_use]
    pub fn with_row_sigmas(self, row_sigmas_rad: Vec<f32>) -> Self {
        assert_eq!(row_sigmas_rad.len(), self.rows, "a row has one tilt");
        Self { row_sigmas_rad, ..self }
    }

    /// The grid with what its ranges are cut to, told from them cell by cell.
    ///
    /// # Panics
    ///
    /// When there is not one for each cell.
    #[must_use]
    pub fn with_ranges(self, ranges_m: &[f32]) -> Self {
        assert_eq!(ranges_m.len(), self.points.len(), "a cell has one range");
        Self { rounding: Rounding::of_ranges(ranges_m), ..self }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// All points, row by row.
    pub fn points(&self) -> &[[f32; 3]] {
        &self.points
    }

    /// Standard deviations of the rows' tilts in radians; empty where they are not known.
    pub fn row_sigmas_rad(&self) -> &[f32] {
        &self.row_sigmas_rad
    }

    /// What the ranges are cut to, as far as that is known.
    pub fn rounding(&self) -> Option<&Rounding> {
        self.rounding.as_ref()
    }

    /// The point of a cell, if it has one.
    pub fn point(&self, row: usize, column: usize) -> Option<Point3<f64>> {
        let [x, y, z] = self.points[row * self.columns + column];
        (x.is_finite() && y.is_finite() && z.is_finite())
            .then(|| Point3::new(f64::from(x), f64::from(y), f64::from(z)))
    }

    /// The grid in a frame whose axes are the same and whose origin is `viewpoint`.
    #[must_use]
    pub fn seen_from(self, viewpoint: &Point3<f64>) -> Self {
        let moved = |[x, y, z]: [f32; 3]| {
            let point = Vector3::new(f64::from(x), f64::from(y), f64::from(z)) - viewpoint.coords;
            point.map(|v| v as f32).into()
        };
        Self { points: self.points.into_iter().map(moved).collect(), ..self }
    }

    /// The grid of the columns `columns` alone, cut to those that exist.
    #[must_use]
    pub fn columns_only(&self, columns: std::ops::Range<usize>) -> Self {
        let end = columns.end.min(self.columns);
        let start = columns.start.min(end);
        let points = self
            .points
            .chunks(self.columns.max(1))
            .flat_map(|row| row[start..end].iter().copied())
            .collect();
        let row_sigmas_rad = self.row_sigmas_rad.clone();
        let rounding =
            self.rounding.as_ref().map(|known| known.columns_only(start..end, self.columns));
        Self { row_sigmas_rad, rounding, ..Self::new(self.rows, end - start, points) }
    }
}
