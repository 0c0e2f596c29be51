//! `Sound` (UT2004) and `Acoustic` (UDK).

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// `SEN {Type Sound} {Name n} {Loudness l} {Duration d}` (UT2004; known from one client).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sound {
    /// When the line was written, if the server says.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// As the server wrote it.
    pub loudness: Option<f64>,
    /// Seconds.
    pub duration_s: Option<f64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Sound {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            time: fields.time(),
            name: fields.name(),
            loudness: fields.number("Loudness"),
            duration_s: fields.number("Duration"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "Sound").text_unless_empty("Name", &self.name);
        w.optional_number("Loudness", self.loudness, 4);
        w.optional_number("Duration", self.duration_s, 4).extra(&self.extra);
    }
}

/// One sound that the acoustic sensor heard.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum HeardSound {
    /// `{Far}`: too far to be located.
    Far,
    /// `{Direction x,y,z} {Volume v} {Duration s} {Delay s}`.
    Near {
        /// Unit vector towards the source.
        direction: [f64; 3],
        /// As the server wrote it.
        volume: f64,
        /// Seconds.
        duration_s: f64,
        /// Seconds from the source to the sensor.
        delay_s: f64,
    },
}

/// `SEN {Time t} {Type Acoustic} {Name n} {None}`, or the sounds heard in the last second (UDK).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Acoustic {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// The actor's internal name, not the item's.
    pub name: String,
    /// All sounds in wire order; none is written as `{None}`.
    pub sounds: Vec<HeardSound>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Acoustic {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let (time, name) = (fields.time(), fields.name());
        fields.take("None");
        // A far sound stands before, between or after the located ones; its order among them says
        // nothing, so far sounds come first.
        let far = fields.take_where(|key, _| key.eq_ignore_ascii_case(b"Far").then_some(()));
        let groups = fields.groups("Direction");
        let near = fields.read_groups(groups, |group| {
            let direction = group.vector("Direction");
            let direction = group.require("Direction", direction)?;
            let mut number = |key: &str| {
                let value = group.number(key);
                group.require(key, value)
            };
            let (volume, duration_s) = (number("Volume")?, number("Duration")?);
            Ok(HeardSound::Near { direction, volume, duration_s, delay_s: number("Delay")? })
        });
        let sounds = far.iter().map(|()| HeardSound::Far).chain(near).collect();
        Ok(Self { time, name, sounds, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "Acoustic").text_unless_empty("Name", &self.name);
        if self.sounds.is_empty() {
            w.bare("None");
        }
        for sound in &self.sounds {
            match sound {
                HeardSound::Far => {
                    w.bare("Far");
                }
                HeardSound::Near { direction, volume, duration_s, delay_s } => {
                    w.shortest_list("Direction", direction).shortest("Volume", *volume);
                    w.shortest("Duration", *duration_s).shortest("Delay", *delay_s);
                }
            }
        }
        w.extra(&self.extra);
    }
}
