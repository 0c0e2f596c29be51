//! Binary morphology on images of bytes, 0 or 1, stored row after row.

/// Buffers of the operations.
#[derive(Clone, Debug, Default)]
pub(super) struct Morphology {
    first: Vec<u8>,
    second: Vec<u8>,
    stack: Vec<u32>,
}

impl Morphology {
    /// Closes gaps: a dilation and an erosion by 3 x 3 cells. What lies outside the image counts as
    /// set, so that borders stay closed there.
    pub fn close(&mut self, image: &mut [u8], width: usize) {
        self.dilate(image, width);
        for cell in image.iter_mut() {
            *cell = 1 - *cell;
        }
        self.dilate(image, width);
        for cell in image.iter_mut() {
            *cell = 1 - *cell;
        }
    }

    /// Sets every cell that has a set one among its eight neighbours.
    pub fn dilate(&mut self, image: &mut [u8], width: usize) {
        if width == 0 {
            return;
        }
        self.first.clear();
        self.first.extend_from_slice(image);
        for (row, out) in self.first.chunks(width).zip(image.chunks_mut(width)) {
            for i in 0..width {
                let left = if i > 0 { row[i - 1] } else { 0 };
                let right = if i + 1 < width { row[i + 1] } else { 0 };
                out[i] = row[i] | left | right;
            }
        }
        self.second.clear();
        self.second.extend_from_slice(image);
        let height = image.len() / width;
        for y in 0..height {
            for neighbour in [y.wrapping_sub(1), y + 1] {
                if neighbour < height {
                    let from = &self.second[neighbour * width..(neighbour + 1) * width];
                    for (out, &set) in image[y * width..(y + 1) * width].iter_mut().zip(from) {
                        *out |= set;
                    }
                }
            }
        }
    }

    /// Clears 8-connected specks of fewer than `fewest` set cells.
    pub fn drop_specks(&mut self, image: &mut [u8], width: usize, fewest: usize) {
        self.first.clear();
        self.first.extend_from_slice(image);
        for start in 0..image.len() {
            if self.first[start] == 0 {
                continue;
            }
            self.stack.clear();
            self.stack.push(start as u32);
            self.first[start] = 0;
            let mut at = 0;
            while at < self.stack.len() {
                let cell = self.stack[at] as usize;
                at += 1;
                for neighbour in neighbours8(cell, width, image.len()) {
                    if self.first[neighbour] != 0 {
                        self.first[neighbour] = 0;
                        self.stack.push(neighbour as u32);
                    }
                }
            }
            if self.stack.len() < fewest {
                for &cell in &self.stack {
                    image[cell as usize] = 0;
                }
            }
        }
    }
}

/// The cells that touch `cell` in an image of `width` and `length` cells, in order.
#[inline]
pub(super) fn neighbours8(cell: usize, width: usize, length: usize) -> impl Iterator<Item = usize> {
    let lane = cell as u32 % width as u32;
    let (left, right) = (lane > 0, lane + 1 < width as u32);
    let (up, down) = (cell >= width, cell + width < length);
    let sides = [
        (up && left, cell.wrapping_sub(width + 1)),
        (up, cell.wrapping_sub(width)),
        (up && right, cell.wrapping_sub(width).wrapping_add(1)),
        (left, cell.wrapping_sub(1)),
        (right, cell + 1),
        (down && left, cell + width - 1),
        (down, cell + width),
        (down && right, cell + width + 1),
    ];
    // Written one over the other, so that there is no branch for each side.
    let mut cells = [0; 8];
    let mut count = 0;
    for (present, side) in sides {
        cells[count & 7] = side;
        count += usize::from(present);
    }
    cells.into_iter().take(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(rows: &[&str]) -> (Vec<u8>, usize) {
        (rows.concat().bytes().map(|c| u8::from(c == b'#')).collect(), rows[0].len())
    }

    #[test]
    fn closing_joins_a_broken_line_and_keeps_the_rest() {
        let (mut broken, width) = image(&[".......", "...#...", ".......", "...#...", "......."]);
        Morphology::default().close(&mut broken, width);
        // The image's border counts as an edge, so the line is joined to it as well.
        assert_eq!(broken, image(&["...#..."; 5]).0);
    }

    #[test]
    fn dilation_stops_at_the_image_border() {
        let (mut corner, width) = image(&["#...", "....", "...#"]);
        Morphology::default().dilate(&mut corner, width);
        assert_eq!(corner, image(&["##..", "####", "..##"]).0);
    }

    #[test]
    fn specks_go_and_diagonal_lines_stay() {
        let (mut mixed, width) = image(&["##....", "......#", ".....#", "....#."].map(|r| &r[..6]));
        Morphology::default().drop_specks(&mut mixed, width, 3);
        assert_eq!(mixed, image(&["......", "......", "......", "......"]).0);
        let (mut line, width) = image(&["#.....", ".#....", "..#..."]);
        let before = line.clone();
        Morphology::default().drop_specks(&mut line, width, 3);
        assert_eq!(line, before);
    }
}
