//! One script for each hazard of the protocol reference, named for its section; here a client reads
//! it to the end and has what the reference says.

use super::sessions::{Heard, play};
use usar_agent::protocol::command::{Act, Query, Set};
use usar_agent::protocol::message::sen::HeardSound;
use usar_agent::protocol::message::{Conf, Geo, Nfo, Sen, SetResult};
use usar_agent::protocol::{Command, Dialect, Message, ProblemKind};
use usar_agent::time::Stamp;

/// Plays a script and returns what came after the greeting; nothing may be damaged or unknown.
async fn clean(script: &str) -> Vec<Message> {
    let (heard, _) = play(script, &[]).await;
    assert_eq!((&heard.problems[..], &heard.dropped[..]), (&[][..], &[][..]), "{script}");
    after_greeting(heard)
}

fn after_greeting(heard: Heard) -> Vec<Message> {
    let mut messages = heard.messages;
    assert!(matches!(messages.remove(0), Message::Nfo(Nfo::Greeting(_))));
    assert!(!messages.iter().any(|message| matches!(message, Message::Unknown(_))), "{messages:?}");
    messages
}

fn status_seconds(messages: &[Message]) -> Vec<f64> {
    let time = |message: &Message| match message {
        Message::Sta(sta) => Some(sta.time?.seconds()),
        _ => None,
    };
    messages.iter().filter_map(time).collect()
}

fn sensors(messages: Vec<Message>) -> Vec<Sen> {
    let sensor = |message| match message {
        Message::Sen(sen) => sen,
        other => panic!("no sensor: {other:?}"),
    };
    messages.into_iter().map(sensor).collect()
}

#[tokio::test]
async fn line_ends_and_packets_do_not_matter() {
    for script in [
        "1_2_line_ends_of_every_kind",
        "1_2_line_end_split_between_packets",
        "1_2_lines_split_and_joined",
    ] {
        let seconds = status_seconds(&clean(script).await);
        let expected: Vec<f64> = (1..=seconds.len()).map(|n| n as f64).collect();
        assert_eq!(seconds, expected, "{script}");
        assert!(seconds.len() >= 2);
    }
}

#[tokio::test]
async fn blanks_do_not_matter() {
    let messages = clean("1_3_irregular_blanks").await;
    let [
        Message::Geo(Geo::Items(geo)),
        Message::Sen(Sen::Sonar(sonar)),
        Message::Sen(Sen::Odometry(odometry)),
        Message::Sen(Sen::Tachometer(tachometer)),
    ] = messages.as_slice()
    else {
        panic!("{messages:?}")
    };
    assert_eq!(geo.items[0].mount, "P3AT");
    assert_eq!(sonar.readings[0].range_m, 4.469);
    assert_eq!([odometry.x_m, odometry.y_m, odometry.theta_rad], [1.0, 2.0, 0.5]);
    assert!(tachometer.velocities_rad_s.is_empty());
}

#[tokio::test]
async fn repeated_keys_begin_groups() {
    let messages = clean("1_4_repeated_keys").await;
    let [
        Message::MisSta(package),
        Message::Sen(Sen::Rfid(rfid)),
        Message::Sen(Sen::VictSensor(victims)),
    ] = messages.as_slice()
    else {
        panic!("{messages:?}")
    };
    let links: Vec<_> = package.links.iter().map(|link| (link.link, link.value)).collect();
    assert_eq!(links, [(1, 0.1), (2, 0.2)]);
    assert_eq!(rfid.tags[1].location, Some([2.0, 0.0, 0.0]));
    assert_eq!(victims.parts[1].part, "Arm");
}

#[tokio::test]
async fn compound_segments_are_taken_apart() {
    let sensors = sensors(clean("1_4_compound_segments").await);
    let [Sen::Sonar(sonar), Sen::Encoder(encoder), Sen::Touch(touch)] = sensors.as_slice() else {
        panic!("{sensors:?}")
    };
    assert_eq!((sonar.readings[1].name.as_str(), sonar.readings[1].range_m), ("F2", 3.3153));
    assert_eq!((encoder.readings[0].name.as_str(), encoder.readings[0].tick), ("ECLeft", -277));
    assert_eq!((touch.readings[0].name.as_str(), touch.readings[0].touched), ("Touch", false));
}

#[tokio::test]
async fn segments_without_a_key_are_not_lost() {
    let messages = clean("1_4_bare_lists").await;
    let [
        Message::Nfo(Nfo::StartPoses(poses)),
        Message::Sen(Sen::Acoustic(sound)),
        Message::Sen(Sen::PointCloud(cloud)),
    ] = messages.as_slice()
    else {
        panic!("{messages:?}")
    };
    assert_eq!(poses[1].name, "MiddleField");
    assert_eq!(sound.sounds, Vec::<HeardSound>::new());
    assert_eq!(cloud.points, [[1.0, 2.0, 0.5], [1.0, 2.1, 0.5]]);
}

#[tokio::test]
async fn keys_are_read_in_any_case() {
    let messages = clean("1_5_keys_in_any_case").await;
    let [Message::Res(answer), Message::Conf(Conf::RangeScanner(conf)), Message::Sta(status)] =
        messages.as_slice()
    else {
        panic!("{messages:?}")
    };
    let SetResult::Item { ok, memory, .. } = &answer.result else { panic!("{answer:?}") };
    assert_eq!((*ok, memory.as_deref()), (true, Some("two words")));
    assert_eq!(conf.items[0].panning, Some(true));
    assert!(conf.items[0].fov_rad.is_some());
    assert_eq!(status.battery_s, Some(1199));
}

#[tokio::test]
async fn unbalanced_braces_cost_one_line_at_most() {
    let (heard, _) = play("1_6_unbalanced_braces", &[]).await;
    let kinds: Vec<_> = heard.problems.iter().map(|problem| problem.kind.clone()).collect();
    use ProblemKind::{SegmentNotClosed, StrayClose};
    assert_eq!(kinds, [SegmentNotClosed, StrayClose, StrayClose]);
    let messages = after_greeting(heard);
    let Message::ObjectSta(object) = &messages[0] else { panic!("{messages:?}") };
    assert_eq!((object.location, object.memory.as_str()), (Some([1.0, 2.0, 3.0]), "text"));
    // The odometry's name may have been cut, its pose was not.
    assert!(
        matches!(&messages[1], Message::Sen(Sen::Odometry(o)) if o.name.is_empty() && o.x_m == 1.0)
    );
    assert!(matches!(&messages[2], Message::Sen(Sen::Odometry(o)) if o.name == "Odometry"));
    assert_eq!(status_seconds(&messages), [1.0]);
}

#[tokio::test]
async fn minus_zero_is_zero() {
    let messages = clean("1_7_minus_zero").await;
    let [Message::MisSta(package)] = messages.as_slice() else { panic!("{messages:?}") };
    assert_eq!(package.links[0].value, 0.0);
}

#[tokio::test]
async fn long_lines_are_read_and_endless_ones_dropped() {
    let sensors = sensors(clean("1_8_a_line_of_20_kB").await);
    let [Sen::RangeImager(strip)] = sensors.as_slice() else { panic!("{sensors:?}") };
    assert_eq!(strip.ranges_m.as_ref().map(Vec::len), Some(12 * 320));

    let (heard, _) = play("1_8_a_line_without_end", &[]).await;
    let [problem] = heard.dropped.as_slice() else { panic!("{:?}", heard.dropped) };
    assert!(matches!(problem.kind, ProblemKind::Overlong { length: 320_000, .. }));
    assert_eq!(status_seconds(&after_greeting(heard)), [1.0]);
}

#[tokio::test]
async fn commands_may_be_queued_and_queries_overwrite_each_other() {
    let (heard, transcript) = play(
        "2_2_two_queries_in_one_tick_overwrite_each_other",
        &[Command::GetGeo(Query::of("Robot")), Command::GetGeo(Query::of("Sonar"))],
    )
    .await;
    let answers = after_greeting(heard);
    assert_eq!(answers.iter().filter(|message| matches!(message, Message::Geo(_))).count(), 1);
    assert_eq!(transcript.with_verb("GETGEO").len(), 2);
}

#[tokio::test]
async fn init_need_not_wait_for_the_start_poses() {
    use super::ScriptedServer;
    use super::sessions::Client;
    let server = ScriptedServer::start("2_2_init_in_the_packet_of_getstartposes").await;
    let mut client = Client::connect(&server.address).await;
    client
        .writer
        .send(b"GETSTARTPOSES\r\nINIT {ClassName USARBot.P3AT} {Name R1}\r\n")
        .await
        .unwrap();
    let heard = client.hear().await;
    assert_eq!(heard.problems, []);
    let messages = after_greeting(heard);
    assert!(matches!(&messages[0], Message::Nfo(Nfo::StartPoses(poses)) if poses.is_empty()));
    assert!(matches!(&messages[1], Message::Sta(_)));
    client.writer.close().await;
    server.finish().await;
}

#[tokio::test]
async fn death_and_an_empty_battery_are_told() {
    let messages = clean("2_2_robot_killed").await;
    assert!(
        matches!(messages.last(), Some(Message::Die(die)) if die.killer.as_deref() == Some("World"))
    );
    let messages = clean("2_3_battery_empty").await;
    let Some(Message::Sta(last)) = messages.last() else { panic!("{messages:?}") };
    assert_eq!(last.battery_s, Some(0));
}

#[tokio::test]
async fn start_poses_come_in_two_forms_and_with_equal_names() {
    for (script, names) in [
        ("2_5_start_poses_with_equal_names", ["PlayerStart", "PlayerStart"]),
        ("2_5_start_poses_as_compound_segments", ["UnitLoader1", "UnitLoader2"]),
    ] {
        let messages = clean(script).await;
        let [Message::Nfo(Nfo::StartPoses(poses))] = messages.as_slice() else {
            panic!("{messages:?}")
        };
        assert_eq!(poses.iter().map(|pose| pose.name.as_str()).collect::<Vec<_>>(), names);
        assert_ne!(poses[0].pose.location, poses[1].pose.location);
    }
}

#[tokio::test]
async fn types_and_times_may_be_missing() {
    let messages = clean("3_3_status_without_a_type").await;
    assert!(matches!(&messages[0], Message::Sta(sta) if sta.vehicle_type.is_none()));
    assert_eq!(Dialect::of_line(b"STA {Time 29.9739} {Battery 99999}"), Some(Dialect::Udk));

    let times: Vec<_> =
        clean("3_4_sensors_with_and_without_time").await.iter().map(Message::time).collect();
    let at = |seconds| Some(Stamp::from_seconds(seconds));
    assert_eq!(times, [None, at(44.5467), None, at(5085.8188)]);

    let sensors = sensors(clean("3_5_victim_sensor_without_a_name").await);
    let names: Vec<_> = sensors
        .iter()
        .map(|sen| match sen {
            Sen::VictSensor(victims) => victims.name.as_str(),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(names, ["", "", "VictSensor"]);
}

#[tokio::test]
async fn ranges_of_no_return_are_handed_on_as_they_are() {
    let sensors = sensors(clean("3_5_no_return_is_written_in_three_ways").await);
    let [Sen::RangeScanner(ut2004), Sen::RangeScanner(udk)] = sensors.as_slice() else {
        panic!("{sensors:?}")
    };
    assert_eq!(ut2004.ranges_m, [19.995, 20.0, -1.0]);
    assert_eq!(udk.ranges_m, [2.19, 57.31, 57.31]);
}

#[tokio::test]
async fn a_depth_image_has_its_zeros_back() {
    let sensors = sensors(clean("3_5_a_fraction_without_its_zero").await);
    let [Sen::RangeImager(strip)] = sensors.as_slice() else { panic!("{sensors:?}") };
    assert_eq!(strip.ranges_m, Some(vec![3.05, 3.5, 12.0]));
}

#[tokio::test]
async fn a_scan_is_older_than_the_line_after_it() {
    let messages = clean("3_6_scanner_one_burst_behind").await;
    for burst in messages.chunks(2) {
        let [scan, status] = burst else { panic!("{burst:?}") };
        let age = status.time().unwrap() - scan.time().unwrap();
        assert_eq!(age.0, 220_000_000);
    }
}

#[tokio::test]
async fn act_counts_from_zero_and_asta_from_one() {
    let act = Command::Act(Act::angles("KinectActuator", [(1, 0.1)]));
    let (heard, transcript) = play("3_7_links_are_counted_from_one_in_asta", &[act]).await;
    let messages = after_greeting(heard);
    assert!(matches!(&messages[0], Message::AsTa(state) if state.links[0].link == 1));
    assert_eq!(transcript.with_verb("ACT"), ["ACT {Name KinectActuator} {Link 0} {Value 0.1}"]);
}

#[tokio::test]
async fn what_is_not_there_is_answered_bare_or_not_at_all() {
    let messages = clean("3_9_not_found_is_a_bare_answer").await;
    let [
        Message::Geo(Geo::MisPkg(packages)),
        Message::Geo(Geo::Items(sonar)),
        Message::Conf(Conf::Sonar(conf)),
    ] = messages.as_slice()
    else {
        panic!("{messages:?}")
    };
    assert!(packages.items.is_empty() && sonar.items.is_empty() && conf.items.is_empty());
    assert_eq!(sonar.not_found.as_deref(), Some("F9"));

    let ask = [Command::GetGeo(Query::of("Sonar"))];
    let (heard, _) = play("3_9_udk_does_not_answer_what_it_does_not_have", &ask).await;
    assert_eq!(status_seconds(&after_greeting(heard)).len(), 6);
}

#[tokio::test]
async fn one_set_may_have_two_answers() {
    let read = [Command::Set(Set::opcode("RFID", "RFID", "Read", Some("118")))];
    let (heard, _) = play("3_10_two_answers_to_one_set", &read).await;
    let outcomes: Vec<_> = after_greeting(heard)
        .into_iter()
        .map(|message| match message {
            Message::Res(answer) => match answer.result {
                SetResult::Item { ok, .. } => ok,
                other => panic!("{other:?}"),
            },
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(outcomes, [false, true]);
}

#[tokio::test]
async fn a_smaller_maximum_than_minimum_is_no_limit() {
    let messages = clean("3_11_limits_that_are_none").await;
    let [Message::Conf(Conf::MisPkg(packages))] = messages.as_slice() else {
        panic!("{messages:?}")
    };
    let links = &packages.items[0].links;
    assert_eq!((links[0].limits(), links[1].limits()), (None, Some([-0.16, 0.40])));
}

#[tokio::test]
async fn what_is_unknown_is_kept_and_is_no_problem() {
    let (heard, _) = play("9_unknown_messages_and_keys", &[]).await;
    assert_eq!(heard.problems, []);
    let [_, Message::Unknown(verb), Message::Unknown(sensor), Message::Sta(status)] =
        heard.messages.as_slice()
    else {
        panic!("{:?}", heard.messages)
    };
    assert_eq!((verb.verb.as_str(), sensor.get("counts")), ("WEATHER", Some("12")));
    assert_eq!((status.extra[0].body(), status.battery_s), ("Mood good", Some(1199)));
}

#[test]
fn every_script_is_played() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/scripted/scripts");
    let tests = [include_str!("hazards.rs"), include_str!("sessions.rs"), include_str!("agent.rs")]
        .concat();
    let mut unplayed = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        if !tests.contains(&format!("\"{name}\"")) {
            unplayed.push(name);
        }
    }
    unplayed.sort();
    assert!(unplayed.is_empty(), "scripts without a test: {unplayed:?}");
}
