//! A small 2D raster: lines, filled polygons, circles and text with anti-aliased edges, as PNG.
//!
//! Pixel coordinates run x right, y down; the centre of the first pixel is (0.5, 0.5).

use super::font::{GLYPH_HEIGHT, GLYPH_WIDTH, glyph};
use nalgebra::Point2;

/// A colour with opacity; components are sRGB as written into the file, blended without gamma.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Colour {
    /// Red, 0 to 255.
    pub red: u8,
    /// Green, 0 to 255.
    pub green: u8,
    /// Blue, 0 to 255.
    pub blue: u8,
    /// Opacity, 0 (invisible) to 255 (opaque).
    pub alpha: u8,
}

impl Colour {
    /// Opaque white.
    pub const WHITE: Self = Self::rgb(255, 255, 255);
    /// Opaque black.
    pub const BLACK: Self = Self::rgb(0, 0, 0);

    /// An opaque colour.
    pub const fn rgb(red: u8, green: u8, blue: u8) -> Self {
        Self { red, green, blue, alpha: 255 }
    }

    /// The same colour with another opacity.
    #[must_use]
    pub const fn with_alpha(self, alpha: u8) -> Self {
        Self { alpha, ..self }
    }

    /// The same colour with its components multiplied by `factor`, cut at white.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        let scale = |component: u8| (f64::from(component) * factor).round().clamp(0.0, 255.0) as u8;
        Self {
            red: scale(self.red),
            green: scale(self.green),
            blue: scale(self.blue),
            alpha: self.alpha,
        }
    }

    /// A mixture of two colours: `self` at 0, `other` at 1.
    #[must_use]
    pub fn mixed(self, other: Self, share: f64) -> Self {
        let share = share.clamp(0.0, 1.0);
        let mix =
            |a: u8, b: u8| (f64::from(a) * (1.0 - share) + f64::from(b) * share).round() as u8;
        Self {
            red: mix(self.red, other.red),
            green: mix(self.green, other.green),
            blue: mix(self.blue, other.blue),
            alpha: mix(self.alpha, other.alpha),
        }
    }
}

/// The `index`-th of an endless row of colours that neighbours can be told apart by.
///
/// Hues step by the golden angle, so any run of successive indices is spread over the circle.
pub fn distinct_colour(index: usize) -> Colour {
    const GOLDEN_TURN: f64 = 0.381_966_011_250_105;
    let hue = (index as f64 * GOLDEN_TURN).fract() * 6.0;
    let (saturation, value) = ([0.75, 0.50, 0.90][index % 3], [0.90, 0.75, 0.65][(index / 3) % 3]);
    let channel = |shift: f64| {
        let distance = ((hue + shift).rem_euclid(6.0) - 3.0).abs() - 1.0;
        (255.0 * value * (1.0 - saturation + saturation * distance.clamp(0.0, 1.0))).round() as u8
    };
    Colour::rgb(channel(0.0), channel(4.0), channel(2.0))
}

/// An opaque picture that is drawn on.
#[derive(Clone, Debug, PartialEq)]
pub struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 3]>,
}

impl Canvas {
    /// A picture of `width × height` pixels, at least one each way, filled with `background`.
    pub fn new(width: usize, height: usize, background: Colour) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        let pixel = [background.red, background.green, background.blue];
        Self { width, height, pixels: vec![pixel; width * height] }
    }

    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The colour of a pixel, if it is within the picture.
    pub fn pixel(&self, x: usize, y: usize) -> Option<Colour> {
        (x < self.width && y < self.height).then(|| {
            let [red, green, blue] = self.pixels[y * self.width + x];
            Colour::rgb(red, green, blue)
        })
    }

    /// Lays `colour` over one pixel; outside the picture nothing happens.
    pub fn blend(&mut self, x: i64, y: i64, colour: Colour) {
        self.cover(x, y, colour, 1.0);
    }

    /// Lays `colour` over the share `coverage` of one pixel.
    fn cover(&mut self, x: i64, y: i64, colour: Colour, coverage: f64) {
        let inside = (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
        let share = f64::from(colour.alpha) / 255.0 * coverage;
        if !inside || share <= 0.0 {
            return;
        }
        let pixel = &mut self.pixels[y as usize * self.width + x as usize];
        for (below, above) in pixel.iter_mut().zip([colour.red, colour.green, colour.blue]) {
            let mixed = f64::from(*below) * (1.0 - share) + f64::from(above) * share;
            *below = mixed.round().clamp(0.0, 255.0) as u8;
        }
    }

    /// A straight line of `width` pixels with round ends.
    pub fn line(&mut self, a: Point2<f64>, b: Point2<f64>, width: f64, colour: Colour) {
        let along = b - a;
        let length_squared = along.norm_squared();
        self.shade(a.inf(&b), a.sup(&b), 0.5 * width, colour, |p| {
            let t = if length_squared > 0.0 {
                ((p - a).dot(&along) / length_squared).clamp(0.0, 1.0)
            } else {
                0.0
            };
            0.5 * width - (p - (a + along * t)).norm()
        });
    }

    /// Lines through `points` in order.
    pub fn polyline(&mut self, points: &[Point2<f64>], width: f64, colour: Colour) {
        for pair in points.windows(2) {
            self.line(pair[0], pair[1], width, colour);
        }
    }

    /// A filled circle.
    pub fn disc(&mut self, centre: Point2<f64>, radius: f64, colour: Colour) {
        self.shade(centre, centre, radius, colour, |p| radius - (p - centre).norm());
    }

    /// The outline of a circle.
    pub fn circle(&mut self, centre: Point2<f64>, radius: f64, width: f64, colour: Colour) {
        self.shade(centre, centre, radius + width, colour, |p| {
            0.5 * width - ((p - centre).norm() - radius).abs()
        });
    }

    /// Covers pixels by a signed distance (positive inside, in pixels): a half-pixel ramp smooths
    /// the edge.
    fn shade(
        &mut self,
        low: Point2<f64>,
        high: Point2<f64>,
        margin: f64,
        colour: Colour,
        inside: impl Fn(Point2<f64>) -> f64,
    ) {
        let bounds = [low.x, low.y, high.x, high.y, margin];
        if bounds.iter().any(|bound| !bound.is_finite()) {
            return;
        }
        let columns = pixel_span(low.x - margin - 1.0, high.x + margin + 1.0, self.width);
        let rows = pixel_span(low.y - margin - 1.0, high.y + margin + 1.0, self.height);
        for y in rows {
            for x in columns.clone() {
                let distance = inside(Point2::new(x as f64 + 0.5, y as f64 + 0.5));
                self.cover(x as i64, y as i64, colour, (distance + 0.5).clamp(0.0, 1.0));
            }
        }
    }

    /// Fills a polygon, convex or not; where it overlaps itself the even-odd rule decides.
    ///
    /// Each pixel row is cut by four lines, along which coverage is exact.
    pub fn polygon_fill(&mut self, polygon: &[Point2<f64>], colour: Colour) {
        const LINES: usize = 4;
        if polygon.len() < 3 || polygon.iter().any(|p| !(p.x.is_finite() && p.y.is_finite())) {
            return;
        }
        let low = polygon.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
        let high = polygon.iter().map(|p| p.y).fold(f64::NEG_INFINITY, f64::max);
        let mut coverage = vec![0.0; self.width];
        let mut crossings = Vec::new();
        for y in pixel_span(low, high, self.height) {
            coverage.fill(0.0);
            for line in 0..LINES {
                let at = y as f64 + (line as f64 + 0.5) / LINES as f64;
                crossings.clear();
                for (i, a) in polygon.iter().enumerate() {
                    let b = &polygon[(i + 1) % polygon.len()];
                    if (a.y <= at) != (b.y <= at) {
                        crossings.push(a.x + (b.x - a.x) * (at - a.y) / (b.y - a.y));
                    }
                }
                crossings.sort_by(f64::total_cmp);
                for span in crossings.chunks_exact(2) {
                    for x in pixel_span(span[0], span[1], self.width) {
                        let left = span[0].max(x as f64);
                        let right = span[1].min(x as f64 + 1.0);
                        coverage[x] += (right - left).max(0.0) / LINES as f64;
                    }
                }
            }
            for (x, &share) in coverage.iter().enumerate().filter(|(_, share)| **share > 0.0) {
                self.cover(x as i64, y as i64, colour, share.min(1.0));
            }
        }
    }

    /// The closed outline of a polygon.
    pub fn polygon_outline(&mut self, polygon: &[Point2<f64>], width: f64, colour: Colour) {
        for (i, &a) in polygon.iter().enumerate() {
            self.line(a, polygon[(i + 1) % polygon.len()], width, colour);
        }
    }

    /// Fills the rectangle from `(x, y)`, `width` to the right and `height` down.
    pub fn rectangle_fill(&mut self, x: f64, y: f64, width: f64, height: f64, colour: Colour) {
        let corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)];
        self.polygon_fill(&corners.map(|(x, y)| Point2::new(x, y)), colour);
    }

    /// Text with its upper left corner at `(x, y)`; each dot of the 5 × 7 font is `scale` pixels
    /// wide, at least 1. `\n` begins a new line.
    pub fn text(&mut self, x: f64, y: f64, scale: usize, text: &str, colour: Colour) {
        let scale = scale.max(1) as i64;
        let left = x.round() as i64;
        let (mut at_x, mut at_y) = (left, y.round() as i64);
        for sign in text.chars() {
            if sign == '\n' {
                at_x = left;
                at_y += (GLYPH_HEIGHT as i64 + 2) * scale;
                continue;
            }
            for (row, bits) in glyph(sign).into_iter().enumerate() {
                for column in (0..GLYPH_WIDTH).filter(|c| bits >> (GLYPH_WIDTH - 1 - c) & 1 == 1) {
                    for dot in 0..scale * scale {
                        let dot_x = at_x + column as i64 * scale + dot % scale;
                        self.blend(dot_x, at_y + row as i64 * scale + dot / scale, colour);
                    }
                }
            }
            at_x += (GLYPH_WIDTH as i64 + 1) * scale;
        }
    }

    /// Width in pixels that [`text`](Self::text) takes for the longest line of `text`.
    pub fn text_width(scale: usize, text: &str) -> f64 {
        let signs = text.lines().map(|line| line.chars().count()).max().unwrap_or(0);
        (signs * (GLYPH_WIDTH + 1) * scale.max(1)) as f64
    }

    /// Copies `picture` with its upper left corner at `(x, y)`; what lies outside is cut off.
    pub fn paste(&mut self, x: usize, y: usize, picture: &Canvas) {
        for row in 0..picture.height.min(self.height.saturating_sub(y)) {
            let columns = picture.width.min(self.width.saturating_sub(x));
            let (from, to) = (row * picture.width, (y + row) * self.width + x);
            self.pixels[to..to + columns].copy_from_slice(&picture.pixels[from..from + columns]);
        }
    }

    /// The rows `rows` alone, cut to those that exist; at least one.
    #[must_use]
    pub fn rows(&self, rows: std::ops::Range<usize>) -> Self {
        let end = rows.end.clamp(1, self.height);
        let start = rows.start.min(end - 1);
        let pixels = self.pixels[start * self.width..end * self.width].to_vec();
        Self { width: self.width, height: end - start, pixels }
    }

    /// The picture at half its size each way, every pixel the mean of four. An odd last row or
    /// column is dropped.
    #[must_use]
    pub fn halved(&self) -> Self {
        let mut half = Self::new(self.width / 2, self.height / 2, Colour::BLACK);
        if self.width < 2 || self.height < 2 {
            return self.clone();
        }
        for y in 0..half.height {
            for x in 0..half.width {
                let mut sums = [2_u16; 3];
                for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    let pixel = self.pixels[(2 * y + row) * self.width + 2 * x + column];
                    for (sum, component) in sums.iter_mut().zip(pixel) {
                        *sum += u16::from(component);
                    }
                }
                half.pixels[y * half.width + x] = sums.map(|sum| (sum / 4) as u8);
            }
        }
        half
    }

    /// The picture as a PNG file, 8 bits RGB.
    pub fn to_png(&self) -> Vec<u8> {
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header().expect("a header for a vector in memory is valid");
        writer
            .write_image_data(self.pixels.as_flattened())
            .expect("the picture has width × height pixels and memory does not fail");
        writer.finish().expect("memory does not fail");
        file
    }
}

/// The pixels between two coordinates, cut to `0..size`.
fn pixel_span(low: f64, high: f64, size: usize) -> std::ops::Range<usize> {
    let start = low.floor().clamp(0.0, size as f64) as usize;
    let end = high.ceil().clamp(0.0, size as f64) as usize;
    start..end.max(start)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ink(canvas: &Canvas) -> f64 {
        let white = 255.0;
        canvas.pixels.iter().map(|pixel| (white - f64::from(pixel[0])) / white).sum()
    }

    #[test]
    fn a_polygon_inks_its_area() {
        let mut canvas = Canvas::new(60, 40, Colour::WHITE);
        let triangle = [(5.3, 4.1), (50.7, 12.9), (20.2, 35.5)].map(|(x, y)| Point2::new(x, y));
        canvas.polygon_fill(&triangle, Colour::BLACK);
        let area = 0.5 * ((50.7 - 5.3) * (35.5 - 4.1) - (20.2 - 5.3) * (12.9 - 4.1));
        assert!((ink(&canvas) - area).abs() < 0.01 * area);
    }

    #[test]
    fn a_line_and_a_disc_ink_their_areas() {
        let mut canvas = Canvas::new(100, 100, Colour::WHITE);
        canvas.line(Point2::new(20.0, 30.0), Point2::new(70.0, 60.0), 3.0, Colour::BLACK);
        let length = f64::hypot(50.0, 30.0);
        assert!((ink(&canvas) - (3.0 * length + 7.07)).abs() < 4.0);
        let mut canvas = Canvas::new(100, 100, Colour::WHITE);
        canvas.disc(Point2::new(50.2, 49.7), 20.0, Colour::BLACK);
        assert!((ink(&canvas) - 1256.6).abs() < 5.0);
    }

    #[test]
    fn shapes_beyond_the_border_are_cut_not_wrapped() {
        let mut canvas = Canvas::new(10, 10, Colour::WHITE);
        canvas.line(Point2::new(-1e9, 5.0), Point2::new(1e9, 5.0), 2.0, Colour::BLACK);
        canvas.disc(Point2::new(f64::NAN, 0.0), 5.0, Colour::BLACK);
        canvas.polygon_fill(&[Point2::new(-5.0, -5.0); 3], Colour::BLACK);
        canvas.text(-3.0, 8.0, 1, "edge", Colour::BLACK);
        assert_eq!(canvas.pixel(5, 1), Some(Colour::WHITE));
        assert_eq!(canvas.pixel(10, 0), None);
        assert!((ink(&canvas) - 20.0).abs() < 12.0);
    }

    #[test]
    fn opacity_mixes_with_what_lies_below() {
        let mut canvas = Canvas::new(4, 4, Colour::WHITE);
        canvas.rectangle_fill(0.0, 0.0, 4.0, 4.0, Colour::BLACK.with_alpha(51));
        assert_eq!(canvas.pixel(2, 2), Some(Colour::rgb(204, 204, 204)));
    }

    #[test]
    fn a_png_reads_back_as_drawn() {
        let mut canvas = Canvas::new(33, 17, Colour::rgb(10, 20, 30));
        canvas.text(2.0, 3.0, 1, "45° 1.5 m", Colour::rgb(250, 200, 0));
        let file = canvas.to_png();
        let mut reader = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels, canvas.pixels.as_flattened());
    }

    #[test]
    fn successive_distinct_colours_differ() {
        for i in 0..60 {
            let (a, b) = (distinct_colour(i), distinct_colour(i + 1));
            let apart =
                a.red.abs_diff(b.red).max(a.green.abs_diff(b.green)).max(a.blue.abs_diff(b.blue));
            assert!(apart > 40, "{i}: {a:?} {b:?}");
        }
    }
}
