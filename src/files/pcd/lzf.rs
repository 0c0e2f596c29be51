//! The LZF compression that PCD files use.
//!
//! A stream of tokens. A control byte below 32 announces that many literal bytes and one more.
//! Otherwise its upper three bits are a match length (7: the next byte is added to it) and its lower
//! five bits, with the byte after, the distance back minus one; the match is two bytes longer than
//! its length says.

/// Longest match that one token of three bytes can hold.
const MAX_MATCH: usize = 264;
/// Farthest that a match may lie back.
const MAX_DISTANCE: usize = 1 << 13;
/// Most literals of one token.
const MAX_LITERALS: usize = 32;

/// Decompresses `block` to exactly `length` bytes; otherwise what is wrong and where.
pub(super) fn decompress(block: &[u8], length: usize) -> Result<Vec<u8>, (&'static str, usize)> {
    // Three bytes make at most MAX_MATCH: a greater claim is a lie and must not be allocated.
    if length > block.len().saturating_mul(MAX_MATCH) / 3 + MAX_MATCH {
        return Err(("the uncompressed size is more than these bytes can hold", 0));
    }
    let mut out = Vec::with_capacity(length);
    let mut at = 0;
    while let Some(&control) = block.get(at) {
        let start = at;
        at += 1;
        let control = usize::from(control);
        if control < MAX_LITERALS {
            let literals = block.get(at..at + control + 1).ok_or(("literals cut short", start))?;
            at += literals.len();
            out.extend_from_slice(literals);
        } else {
            let mut byte = || {
                let byte = block.get(at).copied().ok_or(("a match cut short", start));
                at += 1;
                byte.map(usize::from)
            };
            let mut count = control >> 5;
            if count == 7 {
                count += byte()?;
            }
            let distance = ((control & 31) << 8) + byte()? + 1;
            let from = out.len().checked_sub(distance);
            let from = from.ok_or(("a match before the start", start))?;
            // The match may overlap what it makes, so it is copied byte by byte.
            for i in from..from + count + 2 {
                out.push(out[i]);
            }
        }
        if out.len() > length {
            return Err(("more data than announced", start));
        }
    }
    if out.len() < length {
        return Err(("less data than announced", block.len()));
    }
    Ok(out)
}

/// Compresses `bytes`; [`decompress`] gives them back.
pub(super) fn compress(bytes: &[u8]) -> Vec<u8> {
    const SLOT_BITS: u32 = 14;
    let mut latest = vec![usize::MAX; 1 << SLOT_BITS];
    let mut out = Vec::with_capacity(bytes.len() / 2 + 16);
    let mut literals_from = 0;
    let mut at = 0;
    while at + 2 < bytes.len() {
        let key = u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], 0]);
        let slot = (key.wrapping_mul(2_654_435_761) >> (32 - SLOT_BITS)) as usize;
        let candidate = std::mem::replace(&mut latest[slot], at);
        let length = if candidate < at && at - candidate <= MAX_DISTANCE {
            let most = MAX_MATCH.min(bytes.len() - at);
            (0..most).take_while(|&i| bytes[candidate + i] == bytes[at + i]).count()
        } else {
            0
        };
        if length < 3 {
            at += 1;
            continue;
        }
        push_literals(&mut out, &bytes[literals_from..at]);
        let (count, back) = (length - 2, at - candidate - 1);
        out.push(((count.min(7) << 5) | (back >> 8)) as u8);
        if count >= 7 {
            out.push((count - 7) as u8);
        }
        out.push(back as u8);
        at += length;
        literals_from = at;
    }
    push_literals(&mut out, &bytes[literals_from..]);
    out
}

fn push_literals(out: &mut Vec<u8>, literals: &[u8]) {
    for chunk in literals.chunks(MAX_LITERALS) {
        out.push((chunk.len() - 1) as u8);
        out.extend_from_slice(chunk);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn known_tokens_decompress() {
        // "ab", then eight bytes from two back.
        let block = [1, b'a', b'b', (6 << 5), 1];
        assert_eq!(decompress(&block, 10).unwrap(), b"ababababab");
        // The long form: 7 and the byte after it.
        let block = [0, b'z', (7 << 5), 3, 0];
        assert_eq!(decompress(&block, 13).unwrap(), vec![b'z'; 13]);
    }

    #[test]
    fn a_damaged_block_names_the_fault() {
        assert_eq!(decompress(&[(1 << 5), 9], 3), Err(("a match before the start", 0)));
        assert_eq!(decompress(&[5, 1], 6), Err(("literals cut short", 0)));
        assert_eq!(decompress(&[0, 1], 2), Err(("less data than announced", 2)));
        assert_eq!(decompress(&[1, 1, 1], 1), Err(("more data than announced", 0)));
    }

    #[test]
    fn a_claim_beyond_what_the_bytes_can_hold_is_refused_before_allocation() {
        assert!(decompress(&[0, 1], usize::MAX).is_err());
    }

    proptest! {
        #[test]
        fn compressed_bytes_come_back(bytes in prop::collection::vec(0_u8..4, 0..3000)) {
            prop_assert_eq!(decompress(&compress(&bytes), bytes.len()).unwrap(), bytes);
        }

        #[test]
        fn no_block_panics(
            block in prop::collection::vec(any::<u8>(), 0..200),
            length in 0_usize..5000,
        ) {
            let _ = decompress(&block, length);
        }
    }
}
