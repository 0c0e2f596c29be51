//! Numbers as the engines write them: `[+-] digits [. digits]`, no exponent.
//!
//! Reading is exact: each result has the same bits as the standard library's parser gives. Short
//! decimals, that is all that servers write, take a path that needs one division and no allocation.

use nom::IResult;
use nom::error::{Error, ErrorKind};

/// Powers of ten that a double holds exactly.
const POWERS_OF_TEN: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
];

/// Up to this many digits a `u64` mantissa cannot overflow.
const SAFE_DIGITS: usize = 19;

/// Integers up to here are doubles, so mantissa / power of ten is rounded once, as it should be.
const EXACT_MANTISSA: u64 = 1 << 53;

/// Reads one number from the front of `input`.
///
/// Accepts more than servers write: a leading `+`, `.5`, `5.`, an exponent. Values beyond the
/// range of a double are refused, as are `nan` and `inf`.
pub(super) fn decimal(input: &[u8]) -> IResult<&[u8], f64> {
    let (negative, unsigned) = match input.first() {
        Some(b'-') => (true, &input[1..]),
        Some(b'+') => (false, &input[1..]),
        _ => (false, input),
    };
    let mut mantissa = 0_u64;
    let mut at = 0;
    while let Some(digit) = digit_at(unsigned, at) {
        mantissa = mantissa.wrapping_mul(10).wrapping_add(digit);
        at += 1;
    }
    let mut digits = at;
    let mut fraction = 0;
    if unsigned.get(at) == Some(&b'.') {
        at += 1;
        while let Some(digit) = digit_at(unsigned, at) {
            mantissa = mantissa.wrapping_mul(10).wrapping_add(digit);
            at += 1;
            fraction += 1;
        }
        digits += fraction;
    }
    if digits == 0 {
        return Err(nom::Err::Error(Error::new(input, ErrorKind::Float)));
    }
    let rest = &unsigned[at..];
    if digits > SAFE_DIGITS || mantissa > EXACT_MANTISSA || has_exponent(rest) {
        return long_decimal(input, input.len() - rest.len());
    }
    let magnitude = mantissa as f64 / POWERS_OF_TEN[fraction];
    Ok((rest, if negative { -magnitude } else { magnitude }))
}

#[inline]
fn digit_at(input: &[u8], at: usize) -> Option<u64> {
    let digit = input.get(at)?.wrapping_sub(b'0');
    (digit < 10).then_some(u64::from(digit))
}

fn has_exponent(rest: &[u8]) -> bool {
    matches!(rest, [b'e' | b'E', b'0'..=b'9', ..] | [b'e' | b'E', b'+' | b'-', b'0'..=b'9', ..])
}

/// Numbers that no server writes but that may arrive: many digits, or an exponent.
#[cold]
fn long_decimal(input: &[u8], mut end: usize) -> IResult<&[u8], f64> {
    if has_exponent(&input[end..]) {
        end += 2;
        while digit_at(input, end).is_some() {
            end += 1;
        }
    }
    let value = std::str::from_utf8(&input[..end]).ok().and_then(|text| text.parse::<f64>().ok());
    match value {
        Some(value) if value.is_finite() => Ok((&input[end..], value)),
        _ => Err(nom::Err::Error(Error::new(input, ErrorKind::Float))),
    }
}

/// The number that is all of `wire`, blanks at the ends aside.
pub(super) fn whole(wire: &[u8]) -> Option<f64> {
    match decimal(super::text::trim(wire)) {
        Ok(([], value)) => Some(value),
        _ => None,
    }
}

/// The whole number that is all of `wire`; `12.00` counts as 12.
pub(super) fn integer(wire: &[u8]) -> Option<i64> {
    let value = whole(wire)?;
    (value.fract() == 0.0 && value.abs() < EXACT_MANTISSA as f64).then_some(value as i64)
}

/// What the engine makes of a number typed by a client: the longest number at the front, or 0.
///
/// A decimal comma ends the number, so `1,00` is 1 (protocol document 1.6).
pub(crate) fn engine_number(wire: &[u8]) -> f64 {
    decimal(super::text::trim(wire)).map_or(0.0, |(_, value)| value)
}

/// Reads numbers separated by commas or blanks into `out`, and says whether all of `wire` was.
///
/// A comma may have blanks round it, and one may trail; `1,,2` is damage.
pub(super) fn list(wire: &[u8], out: &mut Vec<f64>) -> bool {
    let mut rest = super::text::trim(wire);
    while !rest.is_empty() {
        if let Some((head, _)) = rest.split_first_chunk()
            && let Some((value, length)) = short_decimal(*head)
        {
            out.push(value);
            rest = &rest[length + 1..];
            if matches!(rest.first(), Some(b' ' | b'\t')) {
                rest = super::text::trim(rest);
            }
            continue;
        }
        let Ok((after, value)) = decimal(rest) else { return false };
        out.push(value);
        rest = match after {
            [] => break,
            [b',', b' ' | b'\t', ..] => super::text::trim(&after[1..]),
            [b',', tail @ ..] => tail,
            [b' ' | b'\t', ..] => {
                let tail = super::text::trim(after);
                tail.strip_prefix(b",").map_or(tail, super::text::trim)
            }
            _ => return false,
        };
    }
    true
}

/// Eight octets with the same value.
const fn eight(octet: u8) -> u64 {
    u64::from_ne_bytes([octet; 8])
}

/// Reads `digits.digits,` of at most seven octets before the comma; also returns their count.
///
/// All ranges of a laser line have this form. Reading eight octets at once needs no branch on the
/// number of digits, which is random between metres and tens of metres; octet by octet the
/// mispredicted branches cost more than the arithmetic.
#[inline]
fn short_decimal(head: [u8; 8]) -> Option<(f64, usize)> {
    let values = u64::from_le_bytes(head) ^ eight(b'0');
    // The high bit of each octet that is no digit. A carry reaches only octets above one that is none
    // itself and above `.`, so that the two lowest are right where they are a point and a comma.
    let others = (values.wrapping_add(eight(0x76)) | values) & eight(0x80);
    let after_first = others & others.wrapping_sub(1);
    let point = others.trailing_zeros() / 8;
    let comma = after_first.trailing_zeros() / 8;
    if comma == 8
        || point == 0
        || (values >> (8 * point)) as u8 != b'.' ^ b'0'
        || (values >> (8 * comma)) as u8 != b',' ^ b'0'
    {
        return None;
    }
    let before_point = (1_u64 << (8 * point)) - 1;
    let closed_up = (values & before_point) | ((values >> 8) & !before_point);
    // Digits to the upper end, zeros below: eight digits with leading zeros, most significant first.
    let digits = closed_up << (8 * (9 - comma));
    let pairs = (digits * 10 + (digits >> 8)) & 0x00ff_00ff_00ff_00ff;
    let fours = (pairs * 100 + (pairs >> 16)) & 0x0000_ffff_0000_ffff;
    let mantissa = (fours * 10_000 + (fours >> 32)) & 0xffff_ffff;
    // Through `i64`, which the processor converts at once; a `u64` takes it two ways and a branch.
    let power = POWERS_OF_TEN[(comma - point - 1) as usize & 7];
    Some((mantissa as i64 as f64 / power, comma as usize))
}

/// Exactly `N` numbers separated by commas or blanks.
pub(super) fn array<const N: usize>(wire: &[u8]) -> Result<[f64; N], Option<usize>> {
    let mut values = Vec::with_capacity(N);
    if !list(wire, &mut values) {
        return Err(None);
    }
    let found = values.len();
    values.try_into().map_err(|_| Some(found))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn standard(text: &str) -> f64 {
        text.parse().unwrap()
    }

    #[test]
    fn forms_beyond_the_grammar_are_read_as_the_standard_parser_does() {
        for text in
            ["+1.5", ".5", "5.", "-0.0000", "1e-5", "2E+3", "123456789012345678901234.5", "-.25"]
        {
            let value = whole(text.as_bytes()).unwrap();
            assert_eq!(value.to_bits(), standard(text).to_bits(), "{text}");
        }
    }

    #[test]
    fn words_and_infinities_are_not_numbers() {
        for text in ["", "-", ".", "nan", "inf", "-1.#IND", "1e999", "1.2.3", "0x10", "1,5"] {
            assert_eq!(whole(text.as_bytes()), None, "{text}");
        }
    }

    #[test]
    fn an_exponent_letter_without_digits_ends_the_number() {
        assert_eq!(decimal(b"1.5east").unwrap(), (&b"east"[..], 1.5));
    }

    #[test]
    fn a_decimal_comma_cuts_the_number_as_the_engine_does() {
        assert_eq!(engine_number(b"1,00"), 1.0);
        assert_eq!(engine_number(b"fast"), 0.0);
    }

    #[test]
    fn lists_take_blanks_and_one_trailing_comma() {
        let read = |text: &str| {
            let mut out = Vec::new();
            list(text.as_bytes(), &mut out).then_some(out)
        };
        assert_eq!(read("1,2,3"), Some(vec![1.0, 2.0, 3.0]));
        assert_eq!(read("1.5, 2.0 ,1.8"), Some(vec![1.5, 2.0, 1.8]));
        assert_eq!(read("4.5 1.9 1.8"), Some(vec![4.5, 1.9, 1.8]));
        assert_eq!(read("3.5,3.5,"), Some(vec![3.5, 3.5]));
        assert_eq!(read("1,,2"), None);
        assert_eq!(read("1,x"), None);
        assert_eq!(array::<3>(b"1,2"), Err(Some(2)));
    }

    #[test]
    fn short_decimals_are_taken_at_once_and_anything_else_is_left() {
        let read = |head: &[u8; 8]| short_decimal(*head);
        assert_eq!(read(b"2.1951,1"), Some((2.1951, 6)));
        assert_eq!(read(b"19.9999,"), Some((19.9999, 7)));
        assert_eq!(read(b"5.,3.3,2"), Some((5.0, 2)));
        assert_eq!(read(b"999999.,"), Some((999_999.0, 7)));
        for head in [
            b"-1.0000,",
            b"123.4567",
            b"12345678",
            b".5,12345",
            b"1.2.3,44",
            b"1,2,3,4,",
            b"1.5e,000",
        ] {
            assert_eq!(read(head), None);
        }
    }

    proptest! {
        #[test]
        fn lists_have_the_bits_of_the_standard_parser(
            texts in proptest::collection::vec("-?[0-9]{1,5}(\\.[0-9]{0,5})?", 0..40)
        ) {
            let mut numbers = Vec::new();
            prop_assert!(list(texts.join(",").as_bytes(), &mut numbers));
            let bits: Vec<_> = numbers.iter().map(|number| number.to_bits()).collect();
            let expected: Vec<_> = texts.iter().map(|text| standard(text).to_bits()).collect();
            prop_assert_eq!(bits, expected);
        }

        #[test]
        fn fixed_decimals_have_the_bits_of_the_standard_parser(
            text in "[+-]?[0-9]{1,22}(\\.[0-9]{0,8})?"
        ) {
            prop_assert_eq!(whole(text.as_bytes()).unwrap().to_bits(), standard(&text).to_bits());
        }
    }
}
