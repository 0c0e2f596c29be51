//! Wire text and Rust strings.
//!
//! The engines send one octet per character, so an octet is read as the character of the same
//! number (Latin-1). That reading is total and loses nothing: whatever arrived can be sent again.

/// The string whose characters are the octets of `wire`.
pub(super) fn from_wire(wire: &[u8]) -> String {
    match std::str::from_utf8(wire) {
        Ok(text) if text.is_ascii() => text.to_owned(),
        _ => wire.iter().copied().map(char::from).collect(),
    }
}

/// Appends `text` as wire octets.
///
/// What would break the line or a segment (`{`, `}`, CR, LF) and what has no octet becomes `_`: a
/// name typed by an operator must not be able to add a segment or a second command.
pub(super) fn push_wire(out: &mut Vec<u8>, text: &str) {
    for c in text.chars() {
        out.push(match u8::try_from(u32::from(c)) {
            Ok(octet) if !matches!(octet, b'{' | b'}' | b'\r' | b'\n') => octet,
            _ => b'_',
        });
    }
}

/// `wire` without blanks at either end; the document knows only the space, a TAB is forgiven.
pub(super) fn trim(wire: &[u8]) -> &[u8] {
    let is_blank = |octet: &u8| matches!(octet, b' ' | b'\t');
    let Some(start) = wire.iter().position(|octet| !is_blank(octet)) else { return &[] };
    let end = wire.iter().rposition(|octet| !is_blank(octet)).map_or(start, |last| last + 1);
    &wire[start..end]
}

/// The first word of a trimmed text and what follows the blanks after it.
pub(super) fn split_word(wire: &[u8]) -> (&[u8], &[u8]) {
    match wire.iter().position(|octet| matches!(octet, b' ' | b'\t')) {
        Some(end) => (&wire[..end], trim(&wire[end..])),
        None => (wire, &[]),
    }
}

/// The words of a text, none of them empty.
pub(super) fn words(wire: &[u8]) -> impl Iterator<Item = &[u8]> {
    wire.split(|octet| matches!(octet, b' ' | b'\t')).filter(|word| !word.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_octet_survives_both_ways() {
        let legal: Vec<u8> = (0..=255).filter(|o| !b"{}\r\n".contains(o)).collect();
        let mut back = Vec::new();
        push_wire(&mut back, &from_wire(&legal));
        assert_eq!(back, legal);
    }

    #[test]
    fn text_cannot_add_a_segment_or_a_line() {
        let mut out = Vec::new();
        push_wire(&mut out, "R1}\r\nDRIVE {Left 9\u{1F916}");
        assert_eq!(out, b"R1___DRIVE _Left 9_");
    }
}
