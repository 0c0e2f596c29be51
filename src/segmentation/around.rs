//! How many of the eight neighbours of each cell of an image have its label, for all cells at once.

use super::compete::NO_RETURN;
use pulp::{Arch, Simd, WithSimd};
use wide::u8x16;

/// Cells that are looked at at a time.
const PART: usize = 32;
/// Cells that have one bit each in a word.
pub(super) const WORD: usize = 64;

/// What is told of a cell by a byte.
pub(super) trait Code {
    /// The code of a cell with a label, and with another one or its own right of it; of its neighbours,
    /// `same` have its label and `none` have no return. Those that are not there count as those next
    /// to them.
    fn of<T: Label>(own: T, right: T, same: T, none: T) -> u8;
}

/// A label that takes no more room than the number of labels asks for; the largest stands for no return.
pub(super) trait Label:
    Copy + PartialEq + From<bool> + From<u8> + std::ops::Add<Output = Self>
{
    /// A label, whose uppermost bits are none or those of no return.
    fn narrow(label: u32) -> Self;
    /// A number below 256.
    fn byte(self) -> u8;
}

macro_rules! labels {
    ($($narrow:ty),*) => {$(
        impl Label for $narrow {
            #[inline(always)]
            fn narrow(label: u32) -> Self {
                label as Self
            }
            #[inline(always)]
            fn byte(self) -> u8 {
                self as u8
            }
        }
    )*};
}
labels!(u8, u16, u32);

/// Buffers of images of narrow labels.
#[derive(Clone, Debug, Default)]
pub(super) struct Around {
    bytes: Vec<u8>,
    shorts: Vec<u16>,
    words: Vec<u32>,
}

impl Around {
    /// Writes the code of each cell, and some more bytes that come to whole words and are zero; labels
    /// are below `count` or those of no return.
    pub fn look<C: Code>(
        &mut self,
        labels: &[u32],
        (width, count): (usize, usize),
        codes: &mut Vec<u8>,
    ) {
        codes.resize(labels.len() + WORD, 0);
        if labels.is_empty() {
            codes.fill(0);
            return;
        }
        let code = std::marker::PhantomData::<C>;
        if count <= usize::from(u8::MAX) {
            let padded = &mut self.bytes;
            Arch::new().dispatch(Look { labels, width, padded, codes, code });
        } else if count <= usize::from(u16::MAX) {
            let padded = &mut self.shorts;
            Arch::new().dispatch(Look { labels, width, padded, codes, code });
        } else {
            let padded = &mut self.words;
            Arch::new().dispatch(Look { labels, width, padded, codes, code });
        }
        codes[labels.len()..].fill(0);
    }
}

/// One look; its loops are over arrays, so that they run on vectors of any width.
struct Look<'a, T, C> {
    labels: &'a [u32],
    width: usize,
    /// The labels with one more cell on all sides, which have the label of the next one.
    padded: &'a mut Vec<T>,
    codes: &'a mut [u8],
    code: std::marker::PhantomData<C>,
}

impl<T: Label, C: Code> WithSimd for Look<'_, T, C> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { labels, width, padded, codes, .. } = self;
        let (stride, height) = (width + 2, labels.len() / width);
        padded.resize((height + 2) * stride + PART, T::from(false));
        // Parts reach into the next row, which is written after.
        for row in 0..height {
            let (from, to) = (row * width, (row + 1) * stride + 1);
            for column in (0..width).step_by(PART) {
                let to: &mut [T; PART] = part_mut(padded, to + column);
                if let Some(from) = labels[from + column..].first_chunk::<PART>() {
                    *to = from.map(T::narrow);
                } else {
                    for (to, from) in to.iter_mut().zip(&labels[from + column..]) {
                        *to = T::narrow(*from);
                    }
                }
            }
            padded[to - 1] = padded[to];
            padded[to + width] = padded[to + width - 1];
        }
        padded.copy_within(stride..2 * stride, 0);
        padded.copy_within(height * stride..(height + 1) * stride, (height + 1) * stride);
        let parts = width.div_ceil(PART);
        for row in 0..height {
            let columns = |row: usize| {
                let first = row * stride;
                [first, first + 1, first + 2].map(|first| {
                    &padded[first..first + parts * PART].as_chunks::<PART>().0[..parts]
                })
            };
            let rows = [columns(row), columns(row + 1), columns(row + 2)];
            let codes = &mut codes[row * width..row * width + parts * PART];
            for (part, codes) in codes.as_chunks_mut().0.iter_mut().enumerate().take(parts) {
                *codes = code_part::<T, C>(rows.map(|row| row.map(|column| &column[part])));
            }
        }
    }
}

#[inline(always)]
fn part_mut<T, const N: usize>(array: &mut [T], first: usize) -> &mut [T; N] {
    array[first..].first_chunk_mut().expect("there is room for a part more")
}

/// The codes of cells, from rows that are one above the other, each from three columns on.
#[inline(always)]
fn code_part<T: Label, C: Code>(rows: [[&[T; PART]; 3]; 3]) -> [u8; PART] {
    let [[a, b, c], [left, here, right], [d, e, f]] = rows;
    let no_return = T::narrow(NO_RETURN);
    let mut codes = [0; PART];
    for i in 0..PART {
        let near = [a[i], b[i], c[i], left[i], right[i], d[i], e[i], f[i]];
        let count =
            |label: T| near.iter().fold(T::from(false), |sum, &near| sum + T::from(near == label));
        codes[i] = C::of(here[i], right[i], count(here[i]), count(no_return));
    }
    codes
}

/// The bits of the cells for whose codes the uppermost bit of what `test` returns is set.
#[inline(always)]
pub(super) fn bits(codes: &[u8; WORD], test: impl Fn(u8x16) -> u8x16) -> u64 {
    let parts = codes.as_chunks::<16>().0;
    parts
        .iter()
        .rev()
        .fold(0, |bits, part| bits << 16 | u64::from(test(u8x16::new(*part)).to_bitmask()))
}

/// Numbers that are written at a time.
const LISTED: usize = 4;

/// Lists the numbers of the set bits of words; returns how many there are. There must be room for a word
/// more.
#[inline(always)]
pub(super) fn list_bits(words: impl Iterator<Item = u64>, listed: &mut [u32]) -> usize {
    let mut count = 0;
    for (k, mut word) in words.enumerate() {
        let first = (k * WORD) as u32;
        let end = count + word.count_ones() as usize;
        // How many a word has is hard to foretell, so some are written one over the other.
        while count < end {
            for place in part_mut::<_, LISTED>(listed, count) {
                *place = first + word.trailing_zeros();
                word &= word.wrapping_sub(1);
            }
            count += LISTED;
        }
        count = end;
    }
    count
}

/// The codes in words; those that come to no whole one are left out.
#[inline(always)]
pub(super) fn words(codes: &[u8]) -> &[[u8; WORD]] {
    codes.as_chunks().0
}
