//! `DIE`: the game has destroyed the robot.

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use serde::{Deserialize, Serialize};

/// `DIE {Killer k} {DamageType d}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Die {
    /// Who did it.
    pub killer: Option<String>,
    /// How.
    pub damage_type: Option<String>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Die {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            killer: fields.text("Killer"),
            damage_type: fields.text("DamageType"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.optional_text("Killer", self.killer.as_deref());
        w.optional_text("DamageType", self.damage_type.as_deref()).extra(&self.extra);
    }
}
