//! Messages and commands on the wire's decimal grid, as a server or a client of one dialect has
//! them to say.

mod commands;
mod replies;
mod sensors;

pub use commands::command;

use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use usar_agent::protocol::{Dialect, Message, NamedPose, NamedValue, Segment, WirePose};
use usar_agent::time::Stamp;

/// A message of `dialect`.
pub fn message(dialect: Dialect) -> BoxedStrategy<Message> {
    prop_oneof![replies::reply(dialect), sensors::sensor(dialect)].boxed()
}

/// A number with so many decimals; the double nearest to it, as any reader has it.
fn grid(decimals: i32) -> impl Strategy<Value = f64> + Clone {
    (-9_999_999_i64..9_999_999).prop_map(move |steps| steps as f64 / 10_f64.powi(decimals))
}

fn vector(decimals: i32) -> impl Strategy<Value = [f64; 3]> + Clone {
    [grid(decimals), grid(decimals), grid(decimals)]
}

fn pose(decimals: i32) -> impl Strategy<Value = WirePose> + Clone {
    (vector(decimals), vector(decimals))
        .prop_map(|(location, orientation)| WirePose { location, orientation })
}

/// A time of so many decimals within the first eleven days.
fn time(decimals: u32) -> impl Strategy<Value = Option<Stamp>> + Clone {
    let unit = 10_i64.pow(9 - decimals);
    option::of((0..1_000_000 * 10_i64.pow(decimals)).prop_map(move |steps| Stamp(steps * unit)))
}

/// A name of one word.
fn word() -> impl Strategy<Value = String> + Clone {
    "[A-Z][A-Za-z0-9_]{0,9}".prop_filter("no key of the protocol", |word| {
        !["Name", "ID", "Link", "Far", "None", "On", "Off", "Size"].contains(&word.as_str())
    })
}

/// A name that may hold a blank; one with more could not be told from a compound segment.
fn name() -> impl Strategy<Value = String> + Clone {
    prop_oneof![4 => word(), 1 => "[A-Z][a-z]{1,5} [a-z0-9]{1,4}"]
}

/// Segments whose keys no message knows and whose values are no numbers.
fn extra() -> impl Strategy<Value = Vec<Segment>> + Clone {
    let segment = ("x[a-z]{2,6}", "(v[a-z ]{0,8}[a-z])?");
    vec(segment.prop_map(|(key, value)| Segment::new(&key, &value)), 0..3)
}

fn poses(decimals: i32) -> impl Strategy<Value = Vec<NamedPose>> {
    vec((word(), pose(decimals)).prop_map(|(name, pose)| NamedPose { name, pose }), 0..4)
}

fn joints() -> impl Strategy<Value = Vec<NamedValue>> {
    let joint = ("[A-Z]{2}(Flipper|Joint)[0-9]", grid(4));
    vec(joint.prop_map(|(name, value)| NamedValue { name, value }), 0..4)
}

/// The decimals that one dialect prints.
fn by<T>(dialect: Dialect, ut2004: T, udk: T) -> T {
    match dialect {
        Dialect::Ut2004 => ut2004,
        Dialect::Udk => udk,
    }
}
