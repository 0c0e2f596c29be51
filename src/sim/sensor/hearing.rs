//! Ears: the calls of living victims, as `Acoustic` (UDK) and `Sound` (UT2004) tell them.

use super::{Carrier, Mounting};
use crate::protocol::message::sen::{Acoustic, HeardSound, Sound};
use crate::sim::map_file::VictimStatus;
use crate::sim::spec::SensorSpec;
use crate::sim::surroundings::Surroundings;
use crate::sim::wire;
use crate::time::{Span, Stamp};
use nalgebra::{Point3, Vector3};

/// A living victim calls once in this many seconds, each a little after the one before it.
const CALL_EVERY_S: f64 = 5.0;
const CALL_APART_S: f64 = 0.7;

/// How long a call lasts in seconds, and how loud it is one metre away in decibels.
const CALL_LASTS_S: f64 = 1.4;
const CALL_DB: f64 = 60.0;

/// Height of a mouth above the ground in metres.
const MOUTH_M: f64 = 0.3;

/// So near the mouth it is the victim's own body that is in the way, in metres.
const BODY_M: f64 = 0.5;

/// Beyond this a sound is far, in metres; something between doubles the distance.
const HEARD_WITHIN_M: f64 = 100.0;

const SPEED_OF_SOUND_MPS: f64 = 343.0;

/// An acoustic sensor.
#[derive(Clone, Debug)]
pub(crate) struct Ears {
    pub(crate) mounting: Mounting,
    /// UDK prints the actor's name instead of the item's.
    actor: String,
    last: Stamp,
}

/// One call as it arrives.
struct Call {
    direction: Vector3<f64>,
    /// Absent where it is far.
    volume_db: Option<f64>,
    delay_s: f64,
}

impl Ears {
    pub(crate) fn new(spec: &SensorSpec, carrier: &Carrier<'_>, now: Stamp) -> Self {
        let likes = carrier.class.sensor.iter().filter(|other| other.kind == spec.kind);
        let number = likes.take_while(|other| other.name != spec.name).count();
        Self {
            mounting: Mounting::new(spec, carrier.units),
            actor: format!("AcousticArraySensor_{number}"),
            last: now,
        }
    }

    /// UDK: all sounds since the last line.
    pub(crate) fn acoustic(
        &mut self,
        carrier: &Carrier<'_>,
        surroundings: &Surroundings<'_>,
        now: Stamp,
        time: Stamp,
    ) -> Acoustic {
        let sounds = self.calls(carrier, surroundings, now).into_iter().map(|call| {
            let Some(volume_db) = call.volume_db else { return HeardSound::Far };
            HeardSound::Near {
                direction: wire::vector(&call.direction).map(|value| wire::round(value, 2)),
                volume: wire::round(volume_db, 4),
                duration_s: CALL_LASTS_S,
                delay_s: wire::round(call.delay_s, 4),
            }
        });
        let sounds = sounds.collect();
        Acoustic { time: Some(time), name: self.actor.clone(), sounds, extra: Vec::new() }
    }

    /// UT2004: the loudest sound since the last line, if there was one near enough.
    pub(crate) fn sound(
        &mut self,
        carrier: &Carrier<'_>,
        surroundings: &Surroundings<'_>,
        now: Stamp,
    ) -> Option<Sound> {
        let calls = self.calls(carrier, surroundings, now);
        let loudest = calls.into_iter().filter_map(|call| call.volume_db).max_by(f64::total_cmp)?;
        Some(Sound {
            time: None,
            name: self.mounting.name.clone(),
            loudness: Some(wire::truncate(loudest, 4)),
            duration_s: Some(CALL_LASTS_S),
            extra: Vec::new(),
        })
    }

    fn calls(
        &mut self,
        carrier: &Carrier<'_>,
        surroundings: &Surroundings<'_>,
        now: Stamp,
    ) -> Vec<Call> {
        let world_from_sensor = carrier.world_from_sensor(&self.mounting);
        let ear = Point3::from(world_from_sensor.translation.vector);
        let since = std::mem::replace(&mut self.last, now);
        let mut calls = Vec::new();
        let living = surroundings.world.victims().iter().enumerate();
        for (number, victim) in living.filter(|(_, it)| it.status == VictimStatus::Alive) {
            let Some(began) = last_call(number, now).filter(|began| *began > since) else {
                continue;
            };
            let mouth = victim.world_from_victim * Point3::new(0.0, 0.0, MOUTH_M);
            let way = mouth - ear;
            let metres = way.norm();
            let clear_m = (metres - BODY_M).max(0.0);
            let hidden = surroundings.cast(&ear, &(way / metres), clear_m).is_some();
            let heard_as_from_m = if hidden { 2.0 * metres } else { metres };
            let volume_db = CALL_DB - 20.0 * heard_as_from_m.max(1.0).log10();
            let near = heard_as_from_m <= HEARD_WITHIN_M && volume_db >= 0.0;
            let arrives = began + Span::from_seconds(metres / SPEED_OF_SOUND_MPS);
            calls.push(Call {
                direction: world_from_sensor.rotation.inverse() * (way / metres),
                volume_db: near.then_some(volume_db),
                delay_s: (arrives - now).seconds().max(0.0),
            });
        }
        calls
    }
}

/// When the victim of that number last began to call.
fn last_call(victim: usize, now: Stamp) -> Option<Stamp> {
    let first_s = victim as f64 * CALL_APART_S % CALL_EVERY_S;
    let rounds = ((now.seconds() - first_s) / CALL_EVERY_S).floor();
    (rounds >= 0.0).then(|| Stamp::from_seconds(first_s + rounds * CALL_EVERY_S))
}
