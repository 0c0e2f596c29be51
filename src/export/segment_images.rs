//! Pictures of the stages of a segmentation, and a coloured overview of its result.

use crate::scan::PointGrid;
use crate::segmentation::{Segmentation, Segmenter, StagePixels};
use std::fs;
use std::io;
use std::path::Path;

/// Writes `1_NAME.png`, `2_NAME.png` … for the stages of the segmenter's last run, `range.png`, and
/// `overview.png`: the regions in colour, shaded by range, cells without a region in grey.
///
/// # Errors
///
/// What the file system reports.
pub fn write_stage_images(
    folder: &Path,
    segmenter: &Segmenter,
    grid: &PointGrid,
) -> io::Result<()> {
    if grid.rows() * grid.columns() == 0 {
        return Ok(());
    }
    fs::create_dir_all(folder)?;
    let shade = shade(grid);
    let write = |name: &str, colours: &[[u8; 3]]| {
        let png = png_of(grid.columns(), grid.rows(), colours)?;
        let path = folder.join(name);
        let temporary = folder.join(format!(".{name}.tmp"));
        fs::write(&temporary, png).and_then(|()| fs::rename(&temporary, path))
    };
    let grey: Vec<[u8; 3]> = shade.iter().map(|&s| [s; 3]).collect();
    write("range.png", &grey)?;
    for (number, image) in segmenter.stage_images().iter().enumerate() {
        let colours: Vec<[u8; 3]> = match &image.pixels {
            StagePixels::Grey(pixels) => pixels.iter().map(|&p| [p; 3]).collect(),
            StagePixels::Labels(labels) => labels.iter().map(|&l| colour(l)).collect(),
        };
        write(&format!("{}_{}.png", number + 1, image.name), &colours)?;
    }
    write("overview.png", &overview(segmenter.result(), &shade))
}

fn overview(segmentation: &Segmentation, shade: &[u8]) -> Vec<[u8; 3]> {
    segmentation
        .labels
        .iter()
        .zip(shade)
        .map(|(&label, &shade)| {
            if label == 0 {
                [shade / 3; 3]
            } else {
                colour(u32::from(label))
                    .map(|c| (u16::from(c) * (128 + u16::from(shade) / 2) / 255) as u8)
            }
        })
        .collect()
}

/// Near is bright, far is dark, nothing is black.
fn shade(grid: &PointGrid) -> Vec<u8> {
    let ranges: Vec<f64> = (0..grid.rows() * grid.columns())
        .map(|i| {
            let point = grid.point(i / grid.columns(), i % grid.columns());
            point.map_or(0.0, |p| p.coords.norm())
        })
        .collect();
    let nearest = ranges.iter().copied().filter(|&r| r > 0.0).fold(f64::INFINITY, f64::min);
    let farthest = ranges.iter().copied().fold(0.0, f64::max);
    let scale = (farthest / nearest).ln().max(1e-6);
    ranges
        .iter()
        .map(|&r| if r > 0.0 { (255.0 - 200.0 * (r / nearest).ln() / scale) as u8 } else { 0 })
        .collect()
}

/// A colour for a region: successive numbers are far apart in hue, none is grey; 0 is black.
fn colour(label: u32) -> [u8; 3] {
    if label == 0 {
        return [0; 3];
    }
    // The golden ratio spreads any number of hues; the value alternates so that neighbours in hue
    // differ in brightness too.
    let hue = (f64::from(label) * 0.618_033_988_75).fract() * 6.0;
    let value = [1.0, 0.75, 0.9][label as usize % 3];
    let saturation = [0.9, 0.75, 0.55][label as usize / 3 % 3];
    let channel = |shift: f64| {
        let k = (hue + shift) % 6.0;
        let part = k.min(4.0 - k).clamp(0.0, 1.0);
        (255.0 * value * (1.0 - saturation * part)) as u8
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

fn png_of(width: usize, height: usize, colours: &[[u8; 3]]) -> io::Result<Vec<u8>> {
    let too_large = |_| io::Error::new(io::ErrorKind::InvalidInput, "a picture beyond 2^32 pixels");
    let (width, height) =
        (u32::try_from(width).map_err(too_large)?, u32::try_from(height).map_err(too_large)?);
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(io::Error::other)?;
    writer.write_image_data(&colours.concat()).map_err(io::Error::other)?;
    writer.finish().map_err(io::Error::other)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_regions_have_colours_far_apart() {
        for a in 1..12_u32 {
            for b in a + 1..12 {
                let gap: i32 =
                    (0..3).map(|i| (i32::from(colour(a)[i]) - i32::from(colour(b)[i])).abs()).sum();
                assert!(gap > 40, "{a} {b}: {:?} {:?}", colour(a), colour(b));
            }
        }
    }

    #[test]
    fn a_picture_comes_back_from_its_png() {
        let colours = [[1, 2, 3], [4, 5, 6], [7, 8, 9], [10, 11, 12], [13, 14, 15], [16, 17, 18]];
        let png = png_of(3, 2, &colours).unwrap();
        let mut reader = png::Decoder::new(io::Cursor::new(png)).read_info().unwrap();
        let mut back = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut back).unwrap();
        assert_eq!(back, colours.concat());
    }
}
