//! The two dialects, and how a line gives its server away.

use super::RawLine;
use serde::{Deserialize, Serialize};

/// Which generation of servers is spoken to.
///
/// Reading needs no dialect; writing does, and so does whoever waits for an answer that one of
/// them never sends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Dialect {
    /// Unreal Engine 2, USARSim 2.x–3.x, 2004–2010.
    #[default]
    Ut2004,
    /// Unreal Engine 3, 2011–2013.
    Udk,
}

impl Dialect {
    /// What one line from the server proves about its dialect; `None` if it fits both.
    ///
    /// The first STA decides, by its first segment; before it, start poses with 4 decimals mean UDK
    /// and with 2 UT2004 (protocol document 9). The greeting proves nothing.
    pub fn of_line(line: &[u8]) -> Option<Self> {
        let line = RawLine::parse(line, &mut Vec::new());
        let first = line.segments.first()?;
        match line.verb.to_ascii_uppercase().as_str() {
            "STA" if first.is("Type") => Some(Self::Ut2004),
            "STA" if first.is("Time") => Some(Self::Udk),
            "MISSTA" | "RES" => Some(Self::Ut2004),
            "ASTA" => Some(Self::Udk),
            "EFF" if first.is("Time") => Some(Self::Udk),
            "NFO" if first.is("StartPoses") => of_decimals(line.segments.get(1)?.body(), 2, 4),
            "SEN" if line.get("Type").is_some_and(|t| t.eq_ignore_ascii_case("RangeScanner")) => {
                of_decimals(line.get("Range")?, 4, 2)
            }
            _ => None,
        }
    }
}

/// The dialect whose count of decimals the first number with a point in `list` has.
fn of_decimals(list: &str, ut2004: usize, udk: usize) -> Option<Dialect> {
    let vector = list.split([' ', '\t', ',']).find(|word| word.contains('.'))?;
    let (_, fraction) = vector.split_once('.')?;
    match fraction.len() {
        count if count == ut2004 => Some(Dialect::Ut2004),
        count if count == udk => Some(Dialect::Udk),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_segment_of_a_status_line_decides() {
        let of = |line: &str| Dialect::of_line(line.as_bytes());
        assert_eq!(of("STA {Type GroundVehicle} {Time 1.00}"), Some(Dialect::Ut2004));
        assert_eq!(of("STA {Time 29.9739} {Battery 1199}"), Some(Dialect::Udk));
        assert_eq!(of("STA {Name n} {Size 1,1,1}"), None);
        assert_eq!(of("NFO {Gametype BotDeathMatch} {Level x} {TimeLimit 0}"), None);
    }

    #[test]
    fn decimals_decide_where_no_status_line_has_come() {
        let of = |line: &str| Dialect::of_line(line.as_bytes());
        assert_eq!(
            of("NFO {StartPoses 1} {A 1.00,2.00,0.10 0.00,0.00,0.00}"),
            Some(Dialect::Ut2004)
        );
        assert_eq!(of("NFO {StartPoses 1} {A.b 4.5000,1.9,1 0,0,0}"), None);
        assert_eq!(of("NFO {StartPoses 1} {A 4.5000,1.9000,1.8000 0,0,0}"), Some(Dialect::Udk));
        assert_eq!(of("NFO {StartPoses 0}"), None);
        assert_eq!(of("SEN {Type RangeScanner} {Range 2.19,2.19}"), Some(Dialect::Udk));
    }
}
