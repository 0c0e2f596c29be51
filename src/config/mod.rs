//! TOML files read strictly: every mistake of a file at once, each with its line and, for a
//! misspelt key, the nearest known one.

mod agent;

use serde::de::DeserializeOwned;
use std::fmt;
use std::ops::Range;
use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

/// One thing wrong with a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mistake {
    /// Line, from 1; `None` where no single line is to blame.
    pub line: Option<usize>,
    /// What was found and what was expected.
    pub message: String,
}

/// All that is wrong with one file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct ConfigError {
    /// Name of the file as the user gave it.
    pub file: String,
    /// The mistakes in the order of their lines; never empty.
    pub mistakes: Vec<Mistake>,
}

impl ConfigError {
    /// An error about a file as a whole.
    pub fn whole(file: &str, message: impl Into<String>) -> Self {
        let mistakes = vec![Mistake { line: None, message: message.into() }];
        Self { file: file.to_owned(), mistakes }
    }

    /// Errors about places of a file, each a place such as `phase 2 until_s` or `robot "R1" start` and
    /// what is wrong there. As much of the place as is found in `text` gives the line.
    pub fn located(
        file: &str,
        text: &str,
        places: impl IntoIterator<Item = (String, String)>,
    ) -> Self {
        let (document, _) = DeTable::parse_recoverable(text);
        let mut mistakes: Vec<Mistake> = places
            .into_iter()
            .map(|(place, reason)| Mistake {
                line: line_of(text, span_of_place(&document, &place)),
                message: format!("{place}: {reason}"),
            })
            .collect();
        mistakes.sort_by_key(|mistake| mistake.line);
        Self { file: file.to_owned(), mistakes }
    }
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, mistake) in self.mistakes.iter().enumerate() {
            if i > 0 {
                writeln!(f)?;
            }
            match mistake.line {
                Some(line) => write!(f, "{}:{line}: {}", self.file, mistake.message)?,
                None => write!(f, "{}: {}", self.file, mistake.message)?,
            }
        }
        Ok(())
    }
}

/// A value that was well-formed but is out of its range.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Dotted path of the key from the top of the table that was read, array elements by number:
    /// `robot.0.pan_tilt.1.name`.
    pub key: String,
    /// What was found and what was expected.
    pub message: String,
}

/// A configuration that can tell what about its values is impossible.
pub trait Check {
    /// Every value out of its range; empty when all is well.
    fn violations(&self) -> Vec<Violation>;
}

/// Reads `text` as a `T` that has no ranges of its own to check.
///
/// # Errors
///
/// Every syntax error; else every unknown key, wrong type and missing key.
pub fn read_plain<T: DeserializeOwned>(file: &str, text: &str) -> Result<T, ConfigError> {
    let table = section_table(file, text, None)?;
    deserialize_all(text, table).map_err(|mistakes| ConfigError { file: file.to_owned(), mistakes })
}

/// Reads `text` as a `T`.
///
/// # Errors
///
/// Every syntax error; else every unknown key, wrong type and missing key; else every violation.
pub fn read<T: DeserializeOwned + Check>(file: &str, text: &str) -> Result<T, ConfigError> {
    read_table(file, text, None)
}

/// Reads the table `section` of `text` as a `T`; an absent section is an empty one.
///
/// # Errors
///
/// As [`read`].
pub fn read_section<T: DeserializeOwned + Check>(
    file: &str,
    text: &str,
    section: &str,
) -> Result<T, ConfigError> {
    read_table(file, text, Some(section))
}

/// The whole document, or one table of it.
fn section_table<'a>(
    file: &str,
    text: &'a str,
    section: Option<&str>,
) -> Result<Spanned<DeTable<'a>>, ConfigError> {
    let fail = |mistakes: Vec<Mistake>| ConfigError { file: file.to_owned(), mistakes };
    let (document, syntax) = DeTable::parse_recoverable(text);
    if !syntax.is_empty() {
        let mistakes = syntax
            .iter()
            .map(|e| Mistake { line: line_of(text, e.span()), message: e.message().to_owned() })
            .collect();
        return Err(fail(mistakes));
    }
    let Some(name) = section else { return Ok(document) };
    match document.get_ref().get(name) {
        None => Ok(Spanned::new(0..0, DeTable::new())),
        Some(value) => match value.get_ref() {
            DeValue::Table(inner) => Ok(Spanned::new(value.span(), inner.clone())),
            other => {
                let message = format!("`{name}` is a {}, expected a table", other.type_str());
                let line = line_of(text, Some(value.span()));
                Err(fail(vec![Mistake { line, message }]))
            }
        },
    }
}

fn read_table<T: DeserializeOwned + Check>(
    file: &str,
    text: &str,
    section: Option<&str>,
) -> Result<T, ConfigError> {
    let fail = |mistakes: Vec<Mistake>| ConfigError { file: file.to_owned(), mistakes };
    let table = section_table(file, text, section)?;
    let mut table = table;
    let (value, mut mistakes) = deserialize_rest::<T>(text, &mut table);
    // What is left when the offending entries are out has ranges of its own to be within.
    mistakes.extend(value.iter().flat_map(Check::violations).map(|violation| Mistake {
        line: line_of(text, span_of_key(&table, &violation.key)),
        message: format!("`{}`: {}", violation.key, violation.message),
    }));
    mistakes.sort_by_key(|mistake| mistake.line);
    match value {
        Some(value) if mistakes.is_empty() => Ok(value),
        _ => Err(fail(mistakes)),
    }
}

fn deserialize_all<T: DeserializeOwned>(
    text: &str,
    mut table: Spanned<DeTable<'_>>,
) -> Result<T, Vec<Mistake>> {
    match deserialize_rest(text, &mut table) {
        (Some(value), mistakes) if mistakes.is_empty() => Ok(value),
        (_, mistakes) => Err(mistakes),
    }
}

/// Deserializes, and on each mistake takes the offending entry out and tries again, so that one
/// attempt reports them all. Gives what could be read of the rest, if anything.
fn deserialize_rest<T: DeserializeOwned>(
    text: &str,
    table: &mut Spanned<DeTable<'_>>,
) -> (Option<T>, Vec<Mistake>) {
    let mut mistakes = Vec::new();
    let mut removed = Vec::new();
    let mut rest = None;
    loop {
        let error = match T::deserialize(toml::de::Deserializer::from(table.clone())) {
            Ok(value) => {
                rest = Some(value);
                break;
            }
            Err(error) => error,
        };
        // A key that was taken out for its wrong type is not missing as well, nor is one that stands
        // there misspelt.
        let missing = quoted_after(error.message(), "missing field ");
        if !missing.is_some_and(|key| removed.iter().any(|gone| gone == key)) {
            let message = with_nearest_key(error.message());
            removed.extend(quoted_after(&message, "did you mean ").map(str::to_owned));
            mistakes.push(Mistake { line: line_of(text, error.span()), message });
        }
        // A table that lacks a key goes as a whole, so that what stands after it is read; the
        // outermost is read already.
        let Some(span) = error.span().filter(|span| missing.is_none() || *span != table.span())
        else {
            break;
        };
        let Some(key) = remove_innermost(table.get_mut(), &span) else { break };
        removed.push(key);
    }
    mistakes.sort_by_key(|mistake| mistake.line);
    (rest, mistakes)
}

/// Takes the deepest entry whose key or value covers `span` out of the table; gives its key.
fn remove_innermost(table: &mut DeTable<'_>, span: &Range<usize>) -> Option<String> {
    let covers = |outer: Range<usize>| covers(&outer, span);
    let mut hit = None;
    for (key, value) in table.iter_mut() {
        if covers(key.span()) {
            hit = Some(key.get_ref().to_string());
            break;
        }
        let deeper = match value.get_mut() {
            DeValue::Table(inner) => remove_innermost(inner, span),
            DeValue::Array(items) => remove_from_tables(items, span),
            _ => None,
        };
        if deeper.is_some() {
            return deeper;
        }
        if covers(value.span()) {
            hit = Some(key.get_ref().to_string());
            break;
        }
    }
    let key = hit?;
    table.remove(key.as_str());
    Some(key)
}

/// Takes the entry out of the table of an array that has it, or that whole table if `span` is its own;
/// gives the entry's key, nothing for a table.
fn remove_from_tables(items: &mut DeArray<'_>, span: &Range<usize>) -> Option<String> {
    let entry = items.iter_mut().find_map(|item| match item.get_mut() {
        DeValue::Table(inner) => remove_innermost(inner, span),
        _ => None,
    });
    if entry.is_some() {
        return entry;
    }
    let whole = items.iter().position(|item| {
        matches!(item.get_ref(), DeValue::Table(_)) && covers(&item.span(), span)
    })?;
    let others = items.iter().enumerate().filter(|(at, _)| *at != whole);
    *items = others.map(|(_, item)| item.clone()).collect();
    Some(String::new())
}

fn covers(outer: &Range<usize>, span: &Range<usize>) -> bool {
    outer.start <= span.start && span.end <= outer.end
}

/// The text between the first pair of back-ticks after `marker`.
fn quoted_after<'a>(message: &'a str, marker: &str) -> Option<&'a str> {
    let rest = &message[message.find(marker)? + marker.len()..];
    rest.split('`').nth(1)
}

/// Serde's "unknown field" with its list of all fields, shortened to the nearest one.
fn with_nearest_key(message: &str) -> String {
    let Some(unknown) = quoted_after(message, "unknown field ") else {
        return message.to_owned();
    };
    let expected = message.split_once("expected").map_or("", |(_, rest)| rest);
    let known: Vec<&str> = expected.split('`').skip(1).step_by(2).collect();
    let nearest = known
        .iter()
        .map(|key| (strsim::damerau_levenshtein(unknown, key), key))
        .min()
        .filter(|(distance, key)| *distance <= 1 + key.len() / 3);
    match nearest {
        Some((_, key)) => format!("unknown key `{unknown}`, did you mean `{key}`?"),
        None if known.is_empty() => format!("unknown key `{unknown}`; no key is known here"),
        None => format!("unknown key `{unknown}`; known here: {}", known.join(", ")),
    }
}

fn line_of(text: &str, span: Option<Range<usize>>) -> Option<usize> {
    let start = span?.start.min(text.len());
    Some(1 + text.as_bytes()[..start].iter().filter(|&&byte| byte == b'\n').count())
}

fn span_of_key(table: &Spanned<DeTable<'_>>, key: &str) -> Option<Range<usize>> {
    let mut parts = key.split('.');
    let first = table.get_ref().get(parts.next()?)?;
    let mut value = first;
    for part in parts {
        let next = match value.get_ref() {
            DeValue::Table(inner) => inner.get(part),
            DeValue::Array(items) => part.parse().ok().and_then(|i: usize| items.get(i)),
            _ => None,
        };
        match next {
            Some(next) => value = next,
            None => break,
        }
    }
    Some(value.span())
}

/// The span of a place: keys, numbers of array elements from 1, and names of elements in quotes. Where
/// a part is not found, that of the part before it.
fn span_of_place(document: &Spanned<DeTable<'_>>, place: &str) -> Option<Range<usize>> {
    let root = document.get_ref();
    let mut at: Option<&Spanned<DeValue<'_>>> = None;
    let mut span = None;
    for word in place.split_whitespace() {
        let name = word.trim_matches('"');
        let is_named = |item: &&Spanned<DeValue<'_>>| match item.get_ref() {
            DeValue::Table(table) => ["name", "class", "file"].iter().any(|key| {
                table.get(*key).is_some_and(|value| value.get_ref().as_str() == Some(name))
            }),
            _ => false,
        };
        let next = match at.map(Spanned::get_ref) {
            None => root.get(word),
            Some(DeValue::Table(table)) => table.get(word),
            Some(DeValue::Array(items)) if word.starts_with('"') => items.iter().find(is_named),
            Some(DeValue::Array(items)) => {
                word.parse().ok().and_then(|number: usize| items.get(number.checked_sub(1)?))
            }
            Some(_) => None,
        };
        let Some(next) = next else { break };
        span = Some(next.span());
        at = Some(next);
    }
    span
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Clone, Debug, Default, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields, default)]
    struct Inner {
        max_range_m: f64,
        name: String,
    }

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields)]
    struct Outer {
        seed: u64,
        #[serde(default)]
        robot: Vec<Inner>,
        #[serde(default)]
        inner: Inner,
    }

    impl Check for Outer {
        fn violations(&self) -> Vec<Violation> {
            self.robot
                .iter()
                .enumerate()
                .filter(|(_, robot)| robot.max_range_m < 0.0)
                .map(|(i, robot)| Violation {
                    key: format!("robot.{i}.max_range_m"),
                    message: format!("{} m, expected at least 0", robot.max_range_m),
                })
                .collect()
        }
    }

    impl Check for Inner {
        fn violations(&self) -> Vec<Violation> {
            Vec::new()
        }
    }

    fn lines(text: &str) -> Vec<String> {
        read::<Outer>("f.toml", text).unwrap_err().to_string().lines().map(str::to_owned).collect()
    }

    #[test]
    fn all_mistakes_are_reported_at_once_with_line_and_nearest_key() {
        let text =
            "seed = 1\n[inner]\nmax_rang_m = 3.0\n[[robot]]\nname = 5\n[[robot]]\nwheels = 4\n";
        assert_eq!(
            lines(text),
            [
                "f.toml:3: unknown key `max_rang_m`, did you mean `max_range_m`?",
                "f.toml:5: invalid type: integer `5`, expected a string",
                "f.toml:7: unknown key `wheels`; known here: max_range_m, name",
            ]
        );
    }

    #[test]
    fn a_key_of_the_wrong_type_is_not_also_missing() {
        assert_eq!(
            lines("seed = \"one\"\n"),
            ["f.toml:1: invalid type: string \"one\", expected u64"]
        );
        assert_eq!(lines("").len(), 1);
        assert!(lines("")[0].contains("missing field `seed`"));
    }

    #[test]
    fn a_misspelt_key_is_not_also_missing() {
        assert_eq!(lines("sed = 1\n"), ["f.toml:1: unknown key `sed`, did you mean `seed`?"]);
    }

    #[test]
    fn a_table_that_lacks_a_key_does_not_hide_what_stands_after_it() {
        #[derive(Debug, Deserialize)]
        #[serde(deny_unknown_fields)]
        #[expect(dead_code, reason = "only its mistakes are read")]
        struct Fleet {
            robot: Vec<Member>,
            seed: u64,
        }
        #[derive(Debug, Deserialize)]
        #[serde(deny_unknown_fields)]
        #[expect(dead_code, reason = "only its mistakes are read")]
        struct Member {
            class: String,
        }
        let found = |text: &str| {
            let error = read_plain::<Fleet>("f", text).unwrap_err();
            error.mistakes.into_iter().map(|mistake| mistake.line.unwrap()).collect::<Vec<_>>()
        };
        assert_eq!(found("sed = 1\n[[robot]]\nklass = \"A\"\n[[robot]]\nclass = 5\n"), [1, 3, 5]);
        assert_eq!(found("[[robot]]\n[[robot]]\nwheels = 1\nclass = \"A\"\n"), [1, 1, 3]);
    }

    #[test]
    fn violations_name_their_line() {
        let text = "seed = 1\n[[robot]]\n[[robot]]\nname = \"b\"\nmax_range_m = -1.0\n";
        assert_eq!(lines(text), ["f.toml:5: `robot.1.max_range_m`: -1 m, expected at least 0"]);
    }

    #[test]
    fn a_mistake_of_type_does_not_hide_a_value_out_of_range() {
        let text = "seed = \"one\"\n[[robot]]\nmax_range_m = -1.0\nname = 5\n";
        #[derive(Debug, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        struct Lenient {
            seed: u64,
            robot: Vec<Inner>,
        }
        impl Default for Lenient {
            fn default() -> Self {
                Self { seed: 1, robot: Vec::new() }
            }
        }
        impl Check for Lenient {
            fn violations(&self) -> Vec<Violation> {
                Outer { seed: self.seed, robot: self.robot.clone(), inner: Inner::default() }
                    .violations()
            }
        }
        let error = read::<Lenient>("f", text).unwrap_err();
        let lines: Vec<_> = error.mistakes.iter().map(|mistake| mistake.line).collect();
        assert_eq!(lines, [Some(1), Some(3), Some(4)], "{error}");
    }

    #[test]
    fn places_are_found_by_key_number_and_name() {
        let text = "seed = 1\n[[robot]]\nname = \"a\"\n[[robot]]\nname = \"b\"\nwheels = 3\n";
        let line = |place: &str| {
            let places = [(place.to_owned(), "wrong".to_owned())];
            ConfigError::located("f", text, places).mistakes[0].line
        };
        assert_eq!(line("seed"), Some(1));
        assert_eq!(line("robot 2 wheels"), Some(6));
        assert_eq!(line("robot \"b\" wheels"), Some(6));
        assert_eq!(line("robot \"a\" name"), Some(3));
        assert_eq!(line("gone"), None);
    }

    #[test]
    fn syntax_errors_name_their_line() {
        let found = lines("seed = 1\n[inner\nname = \n");
        assert!(found[0].starts_with("f.toml:2:"), "{found:?}");
    }

    #[test]
    fn a_section_is_read_on_its_own() {
        let text = "anything = 1\n[inner]\nname = \"x\"\n";
        assert_eq!(read_section::<Inner>("f", text, "inner").unwrap().name, "x");
        assert_eq!(read_section::<Inner>("f", text, "none").unwrap(), Inner::default());
        assert!(read_section::<Inner>("f", text, "anything").is_err());
    }
}
