//! Reading a file of the simulator strictly: what was wrong, where, and what was meant.

use serde::de::DeserializeOwned;
use std::collections::BTreeSet;
use std::fmt;

/// Why a map, scenario or robot file was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpecError {
    /// Not the expected TOML: a syntax error, an unknown key, a value of another type.
    #[error("{0}")]
    Parse(String),
    /// Values outside their ranges or names that contradict each other, all of them.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Invalid(Vec<Violation>),
}

/// One thing that is wrong in a file: where, and what was expected and found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// The key or item, such as `box "platform" size`.
    pub place: String,
    /// What was expected and what was found.
    pub reason: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.reason)
    }
}

/// Collects violations instead of stopping at the first.
#[derive(Debug, Default)]
pub(crate) struct Check(Vec<Violation>);

impl Check {
    pub(crate) fn that(
        &mut self,
        holds: bool,
        place: impl fmt::Display,
        reason: impl fmt::Display,
    ) {
        if !holds {
            self.0.push(Violation { place: place.to_string(), reason: reason.to_string() });
        }
    }

    pub(crate) fn finite(&mut self, values: &[f64], place: impl fmt::Display) {
        let bad = values.iter().find(|value| !value.is_finite());
        let found = bad.copied().unwrap_or_default();
        self.that(bad.is_none(), place, format_args!("expected finite numbers, found {found}"));
    }

    pub(crate) fn positive(&mut self, values: &[f64], place: impl fmt::Display) {
        let bad = values.iter().find(|value| !(value.is_finite() && **value > 0.0));
        let found = bad.copied().unwrap_or_default();
        self.that(bad.is_none(), place, format_args!("expected positive numbers, found {found}"));
    }

    pub(crate) fn unique<'a>(&mut self, names: impl Iterator<Item = &'a str>, what: &str) {
        let mut seen = BTreeSet::new();
        for name in names.filter(|name| !name.is_empty()) {
            self.that(
                seen.insert(name.to_ascii_lowercase()),
                format_args!("{what} {name:?}"),
                "expected a name of its own, found a second one",
            );
        }
    }

    pub(crate) fn finish<T>(self, value: T) -> Result<T, SpecError> {
        if self.0.is_empty() { Ok(value) } else { Err(SpecError::Invalid(self.0)) }
    }
}

/// Reads TOML into a struct; an unknown key is reported with its line and the nearest known one.
pub(crate) fn read_toml<T: DeserializeOwned>(text: &str) -> Result<T, SpecError> {
    toml::from_str(text).map_err(|error| {
        let line = error.span().map(|span| 1 + text[..span.start].matches('\n').count());
        let message = with_nearest_key(error.message());
        SpecError::Parse(match line {
            Some(line) => format!("line {line}: {message}"),
            None => message,
        })
    })
}

/// `unknown field` messages list every key there is; the nearest one helps more.
fn with_nearest_key(message: &str) -> String {
    let plain = || message.replace('\n', " ");
    let Some(rest) = message.strip_prefix("unknown field `") else { return plain() };
    let mut quoted = rest.split('`');
    let Some(found) = quoted.next() else { return plain() };
    // Every second piece between backquotes is a known key.
    let known = quoted.skip(1).step_by(2);
    let nearest = known.min_by_key(|key| strsim::levenshtein(found, key));
    match nearest {
        Some(nearest) => format!("unknown key `{found}`; the nearest one is `{nearest}`"),
        None => plain(),
    }
}
