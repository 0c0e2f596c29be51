//! `TRACE` and `PAUSE` (UT2004).

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use serde::{Deserialize, Serialize};

/// `TRACE {On 1} {Interval 1} {Color White}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Trace {
    /// Whether marks are left.
    pub on: bool,
    /// Seconds between marks.
    pub interval_s: Option<f64>,
    /// Red, Yellow, Green, Cyan, White, Blue or Purple.
    pub color: Option<String>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Trace {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        let on = match fields.peek("On") {
            Some(b"1") => true,
            Some(value) => crate::protocol::fields::flag(value).unwrap_or(false),
            None => false,
        };
        fields.take("On");
        Self {
            on,
            interval_s: fields.engine_number("Interval"),
            color: fields.text("Color"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.integer("On", i64::from(self.on));
        if let Some(interval) = self.interval_s {
            w.shortest("Interval", interval);
        }
        w.optional_text("Color", self.color.as_deref()).extra(&self.extra);
    }
}

/// `PAUSE {TIME 10}`; sent by one client, its effect is not known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pause {
    /// Presumably seconds.
    pub time: Option<f64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Pause {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self { time: fields.engine_number("TIME"), extra: fields.rest() }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        if let Some(time) = self.time {
            w.shortest("TIME", time);
        }
        w.extra(&self.extra);
    }
}
