//! Commands. Their numbers are any doubles: they are written in the shortest form that reads back.

use super::{extra, name, word};
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use usar_agent::protocol::command::*;
use usar_agent::protocol::{Command, Dialect, NamedValue};

/// A command as `dialect` takes it.
pub fn command(dialect: Dialect) -> BoxedStrategy<Command> {
    prop_oneof![
        init().prop_map(Command::Init),
        Just(Command::GetStartPoses),
        Just(Command::GetPathNodes),
        drive().prop_map(Command::Drive),
        vec((word(), number()), 1..5).prop_map(|joints| {
            let joint = |(name, value)| NamedValue { name, value };
            Command::MultiDrive(MultiDrive { joints: joints.into_iter().map(joint).collect() })
        }),
        mispkg(dialect).prop_map(Command::MisPkg),
        act().prop_map(Command::Act),
        set().prop_map(Command::Set),
        query().prop_map(Command::GetGeo),
        query().prop_map(Command::GetConf),
        (any::<bool>(), option::of(number()), option::of(word()), extra()).prop_map(
            |(on, interval_s, color, extra)| {
                Command::Trace(Trace { on, interval_s, color, extra })
            }
        ),
        (option::of(vector()), option::of(order()), option::of(number()), extra()).prop_map(
            |(rotation, order, zoom, extra)| {
                Command::Camera(CameraCommand { rotation, order, zoom, extra })
            }
        ),
        (option::of(number()), extra())
            .prop_map(|(time, extra)| Command::Pause(Pause { time, extra })),
        control().prop_map(Command::Control),
        (word(), option::of(word()), option::of([number(), number()]), extra()).prop_map(
            |(action, gait, location, extra)| {
                Command::Move(Move { action, gait, location, extra })
            }
        ),
        (name(), extra()).prop_map(|(name, extra)| Command::Goto(Goto { name, extra })),
    ]
    .boxed()
}

/// Any double that a command may hold, tiny and huge ones included.
fn number() -> impl Strategy<Value = f64> + Clone {
    prop_oneof![-10.0..10.0, (-100_i32..100).prop_map(f64::from), prop::num::f64::NORMAL]
}

fn vector() -> impl Strategy<Value = [f64; 3]> + Clone {
    [number(), number(), number()]
}

fn order() -> impl Strategy<Value = Order> {
    prop_oneof![0_i64..4, 10_i64..13, 50_i64..60].prop_map(Order::from_code)
}

fn maybe() -> impl Strategy<Value = Option<f64>> + Clone {
    option::of(number())
}

fn init() -> impl Strategy<Value = Init> {
    (
        word(),
        option::of(name()),
        [option::of(vector()), option::of(vector())],
        option::of(word()),
        extra(),
    )
        .prop_map(|(class, name, [location, rotation], start, extra)| Init {
            class_name: format!("USARBot.{class}"),
            name,
            location,
            rotation,
            start,
            team: Some(255),
            extra,
        })
}

fn drive() -> impl Strategy<Value = Drive> {
    let form = prop_oneof![
        Just(DriveForm::None),
        (number(), maybe()).prop_map(|(left, right)| DriveForm::Skid { left: Some(left), right }),
        (number(), maybe(), maybe()).prop_map(|(speed, front_steer, rear_steer)| {
            DriveForm::Ackermann { speed: Some(speed), front_steer, rear_steer }
        }),
        (number(), [maybe(), maybe(), maybe()], [maybe(), maybe()]).prop_map(
            |(altitude, [linear, lateral, rotational], [pitch_deg, roll_deg])| DriveForm::Aerial {
                altitude: Some(altitude),
                linear,
                lateral,
                rotational,
                pitch_deg,
                roll_deg,
            }
        ),
        (number(), maybe(), maybe()).prop_map(|(propeller, rudder, stern_plane)| {
            DriveForm::Nautic { propeller: Some(propeller), rudder, stern_plane }
        }),
        vec((0_i64..9, maybe(), maybe()), 1..4).prop_map(|wheels| {
            let wheel = |(wheel, speed, steer)| WheelCommand { wheel, speed, steer };
            DriveForm::Omni(wheels.into_iter().map(wheel).collect())
        }),
        (name(), [option::of(word()), option::of(word())], maybe(), option::of(order()), maybe())
            .prop_map(|(name, [bone, axis], steer, order, value)| DriveForm::Joint {
                name,
                bone,
                steer,
                order,
                value,
                axis,
            }),
    ];
    let flag = || option::of(any::<bool>());
    (form, flag(), flag(), flag(), extra()).prop_map(|(form, normalized, light, flip, extra)| {
        Drive { form, normalized, light, flip, extra }
    })
}

fn mispkg(dialect: Dialect) -> impl Strategy<Value = MisPkg> {
    // UDK takes a link with its order only, so a missing one is written as 0.
    let order_or_none = match dialect {
        Dialect::Ut2004 => option::of(order()).boxed(),
        Dialect::Udk => order().prop_map(Some).boxed(),
    };
    let link = (1_i64..9, number(), order_or_none).prop_map(|(link, value, order)| MisPkgLink {
        link,
        value,
        order,
    });
    let form = prop_oneof![
        vec(link, 0..4).prop_map(MisPkgForm::Links),
        (vector(), option::of(order()))
            .prop_map(|(rotation, order)| MisPkgForm::Rotation { rotation, order }),
    ];
    let number = || option::of(0_i64..9);
    (name(), form, number(), number(), extra()).prop_map(
        |(name, form, gripper, sequence, extra)| MisPkg { name, form, gripper, sequence, extra },
    )
}

fn act() -> impl Strategy<Value = Act> {
    let link = (1_i64..9, number()).prop_map(|(link, value)| ActLink { link, value });
    let number = || option::of(0_i64..9);
    (name(), vec(link, 0..4), number(), number(), extra()).prop_map(
        |(name, links, gripper, sequence, extra)| Act { name, links, gripper, sequence, extra },
    )
}

fn set() -> impl Strategy<Value = Set> {
    let form =
        prop_oneof![
            (name(), word(), option::of(name()))
                .prop_map(|(name, opcode, params)| SetForm::Opcode { name, opcode, params }),
            (option::of(word()), name(), word())
                .prop_map(|(robot, name, client)| SetForm::CameraClient { robot, name, client }),
            (name(), number()).prop_map(|(name, fov_rad)| SetForm::CameraFov { name, fov_rad }),
            (word(), vec(word(), 0..5)).prop_map(|(config, views)| SetForm::Viewports {
                config,
                views: (1..).zip(views).collect(),
            }),
        ];
    (word(), form, extra()).prop_map(|(type_name, form, extra)| Set { type_name, form, extra })
}

fn query() -> impl Strategy<Value = Query> {
    (word(), option::of(name()), extra()).prop_map(|(type_name, name, extra)| Query {
        type_name,
        name,
        extra,
    })
}

fn control() -> impl Strategy<Value = Control> {
    let some = || option::of(vector());
    let flag = || option::of(any::<bool>());
    let waypoints = (vec(vector(), 0..4), maybe(), maybe(), [flag(), flag(), flag()]).prop_map(
        |(points, speed, time_s, [repeat, reset_on_clear, moving])| Waypoints {
            points,
            speed,
            time_s,
            repeat,
            reset_on_clear,
            moving,
        },
    );
    let create = (word(), vector(), vector(), some(), [option::of(word()), option::of(word())])
        .prop_map(|(class_name, location, rotation, scale, [physics, memory])| {
            ControlAction::Create { class_name, location, rotation, scale, physics, memory }
        });
    let action = prop_oneof![
        create,
        Just(ControlAction::Kill),
        Just(ControlAction::ClearWp),
        option::of([vector(), vector()]).prop_map(|corners| ControlAction::KillAll { corners }),
        (some(), some())
            .prop_map(|(location, rotation)| ControlAction::AbsMove { location, rotation }),
        (some(), some())
            .prop_map(|(location, rotation)| ControlAction::RelMove { location, rotation }),
        vector().prop_map(|speed| ControlAction::Rotate { speed }),
        waypoints.clone().prop_map(ControlAction::AddWp),
        waypoints.prop_map(ControlAction::SetWp),
        number().prop_map(|speed| ControlAction::Conveyor { speed }),
        option::of(word()).prop_map(|class_name| ControlAction::GetSta { class_name }),
        "Q[a-z]{3}".prop_map(ControlAction::Other),
    ];
    (name(), action, extra()).prop_map(|(name, action, extra)| Control { name, action, extra })
}
