//! The `map_server` pair: `map.pgm` and `map.yaml`.

/// What a cell of a trinary map says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cell {
    /// Nothing is known.
    Unknown,
    /// Can be driven on.
    Free,
    /// Must not be driven on: obstacle, drop-off, too steep.
    Occupied,
}

/// A trinary map: `width × height` cells, row by row from the lowest y.
#[derive(Clone, Debug, PartialEq)]
pub struct TrinaryMap {
    /// Cells along x.
    pub width: usize,
    /// Cells along y.
    pub height: usize,
    /// Side of a cell in metres.
    pub resolution_m: f64,
    /// Lower left corner of cell (0, 0) in the map frame, in metres.
    pub origin_m: [f64; 2],
    /// The cells.
    pub cells: Vec<Cell>,
}

impl TrinaryMap {
    /// The picture as binary PGM. The first row of the picture is the greatest y, as `map_server`
    /// expects; unknown is 205, which lies between its two thresholds and so stays unknown when
    /// the map is loaded again.
    pub fn pgm(&self) -> Vec<u8> {
        let mut bytes = format!("P5\n{} {}\n255\n", self.width, self.height).into_bytes();
        for row in self.cells.chunks(self.width.max(1)).rev() {
            bytes.extend(row.iter().map(|cell| match cell {
                Cell::Unknown => 205,
                Cell::Free => 254,
                Cell::Occupied => 0,
            }));
        }
        bytes
    }

    /// The description that goes with [`Self::pgm`] stored under `image`.
    pub fn yaml(&self, image: &str) -> String {
        format!(
            "image: {image}\nmode: trinary\nresolution: {:.6}\norigin: [{:.6}, {:.6}, 0.000000]\n\
             negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
            self.resolution_m, self.origin_m[0], self.origin_m[1]
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_picture_row_is_the_greatest_y() {
        let map = TrinaryMap {
            width: 2,
            height: 2,
            resolution_m: 0.05,
            origin_m: [-1.0, 2.0],
            cells: vec![Cell::Free, Cell::Occupied, Cell::Unknown, Cell::Free],
        };
        assert_eq!(map.pgm(), b"P5\n2 2\n255\n\xcd\xfe\xfe\x00");
        assert!(map.yaml("map.pgm").contains("origin: [-1.000000, 2.000000, 0.000000]"));
    }

    #[test]
    fn unknown_stays_between_the_thresholds() {
        let occupancy = (255.0 - 205.0) / 255.0;
        assert!(occupancy > 0.196 && occupancy < 0.65);
    }
}
