//! The one dense kernel of the graph: a partial Cholesky factorisation.

use nalgebra::DMatrix;

/// Columns that are factorised before the rest of the matrix is updated by one product.
const PANEL: usize = 32;
/// Columns of the trailing part that one product updates; keeps the waste above the diagonal small.
const STRIP: usize = 64;

/// Factorises the first `columns` columns of the symmetric matrix whose lower triangle is the square
/// upper part of `matrix`, in place.
///
/// Afterwards those columns hold L (rows below the diagonal included) and the lower triangle of the
/// rest holds the Schur complement. Rows beyond the square, such as a right-hand side, are carried
/// along. The upper triangle is not read; it is left undefined.
///
/// A pivot that is not positive means a direction about which nothing is known. It is replaced by
/// `floor`, so that the solution stays where it was linearised instead of being undefined; the
/// number of such pivots is returned.
pub fn factorise_leading(matrix: &mut DMatrix<f64>, columns: usize, floor: f64) -> usize {
    let (rows, size) = matrix.shape();
    debug_assert!(columns <= size && size <= rows);
    let mut weak = 0;
    let mut start = 0;
    while start < columns {
        let end = (start + PANEL).min(columns);
        for column in start..end {
            let pivot = matrix[(column, column)];
            let root = if pivot > floor {
                pivot.sqrt()
            } else {
                weak += 1;
                floor.sqrt()
            };
            matrix[(column, column)] = root;
            for value in &mut matrix.column_mut(column).as_mut_slice()[column + 1..] {
                *value /= root;
            }
            let (left, right) = matrix.as_mut_slice().split_at_mut((column + 1) * rows);
            let pivot_column = &left[column * rows..];
            for later in column + 1..end {
                let factor = pivot_column[later];
                if factor == 0.0 {
                    continue;
                }
                let target = &mut right[(later - column - 1) * rows..(later - column) * rows];
                for (value, pivot) in target[later..].iter_mut().zip(&pivot_column[later..]) {
                    *value -= factor * pivot;
                }
            }
        }
        let mut strip = end;
        while strip < size {
            let width = STRIP.min(size - strip);
            let (panel, mut rest) = matrix.columns_range_pair_mut(start..end, strip..strip + width);
            let below = panel.rows(strip, rows - strip);
            let across = panel.rows(strip, width).transpose();
            rest.rows_mut(strip, rows - strip).gemm(-1.0, &below, &across, 1.0);
            strip += width;
        }
        start = end;
    }
    weak
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn partial_factor_and_complement_rebuild_the_matrix(
            size in 1..120_usize, share in 0.0..1.0f64, seed in any::<u64>()
        ) {
            let columns = ((size as f64) * share).ceil() as usize;
            let mut state = seed;
            let mut next = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (state >> 33) as f64 / f64::from(1_u32 << 31) - 0.5
            };
            let root = DMatrix::from_fn(size, size + 3, |_, _| next());
            let square = &root * root.transpose() + DMatrix::identity(size, size) * 0.1;
            let extra = DMatrix::from_fn(1, size, |_, _| next());
            let mut whole = DMatrix::zeros(size + 1, size);
            whole.rows_mut(0, size).copy_from(&square);
            whole.rows_mut(size, 1).copy_from(&extra);
            prop_assert_eq!(factorise_leading(&mut whole, columns, 0.0), 0);
            let mut l = whole.columns(0, columns).into_owned();
            for row in 0..columns {
                for column in row + 1..columns {
                    l[(row, column)] = 0.0;
                }
            }
            let rebuilt = &l * l.rows(0, size).transpose();
            for row in 0..=size {
                for column in 0..size.min(row + 1) {
                    let complement =
                        if column >= columns { whole[(row, column)] } else { 0.0 };
                    let original = if row < size { square[(row, column)] } else { extra[column] };
                    prop_assert!((rebuilt[(row, column)] + complement - original).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn an_unknown_direction_is_counted_and_stays_put() {
        let mut matrix = DMatrix::from_row_slice(3, 2, &[4.0, 0.0, 0.0, 0.0, 2.0, 0.0]);
        assert_eq!(factorise_leading(&mut matrix, 2, 1e-12), 1);
        assert_eq!((matrix[(0, 0)], matrix[(2, 0)], matrix[(2, 1)]), (2.0, 1.0, 0.0));
    }
}
