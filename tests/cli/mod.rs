//! The program as its user meets it: exit codes, one clear line for bad input, files.

use std::fs;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

/// Agent settings under which the first sweep comes early and a silent server is given up soon.
const QUICK: &str = "[mission]\nfine_sweep_at_start = false\n\
                     [opening]\ngreeting_timeout_s = 0.3\nsta_timeout_s = 0.5\n";

fn usar(arguments: &[&str]) -> Output {
    Command::new(assert_cmd::cargo::cargo_bin!("usar")).args(arguments).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Lines on standard error that are neither warnings nor the agent's diary.
fn errors(output: &Output) -> Vec<String> {
    stderr(output).lines().filter(|line| line.starts_with("error")).map(str::to_owned).collect()
}

/// One clear line and exit code 1.
fn fails_with(arguments: &[&str], parts: &[&str]) {
    let output = usar(arguments);
    let errors = errors(&output);
    assert_eq!((output.status.code(), errors.len()), (Some(1), 1), "{}", stderr(&output));
    for part in parts {
        assert!(errors[0].contains(part), "`{part}` is not in `{}`", errors[0]);
    }
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A short mission's run folder.
fn mission(folder: &TempDir, name: &str, seconds: &str) -> std::path::PathBuf {
    let config = folder.path().join("quick.toml");
    fs::write(&config, QUICK).unwrap();
    let out = folder.path().join(name);
    let output = usar(&[
        "mission",
        "box",
        "--time-limit",
        seconds,
        "--config",
        text(&config),
        "--out",
        text(&out),
    ]);
    assert!(output.status.success(), "{}", stderr(&output));
    out
}

#[test]
fn every_verb_shows_an_example_in_its_help() {
    let verbs = [
        "demo", "mission", "sim", "run", "replay", "scan", "segment", "map", "paper", "export",
        "eval", "info", "check",
    ];
    for verb in verbs {
        let output = usar(&[verb, "--help"]);
        let help = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success() && help.contains("Example"), "{verb}: {help}");
        assert!(help.contains(&format!("usar {verb}")), "{verb}: {help}");
    }
}

#[test]
fn an_unknown_verb_and_a_bad_value_are_misuse() {
    for arguments in
        [&["fly"][..], &["mission", "box", "--time-limit", "-1"], &["run", "--location", "1,2"]]
    {
        assert_eq!(usar(arguments).status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn a_demo_takes_the_options_of_the_contract() {
    let folder = tempfile::tempdir().unwrap();
    let options = |name: &str, console: &str| {
        let out = folder.path().join(name);
        let limit = ["demo", "--time-limit", "1", "--stay", "--console", console, "--out"];
        usar(&[&limit[..], &[text(&out)]].concat())
    };
    let off = options("off", "off");
    assert!(off.status.success() && stderr(&off).contains("--stay"), "{}", stderr(&off));
    assert!(!stderr(&off).contains("going on without"), "{}", stderr(&off));
    let asked = options("asked", "127.0.0.1:0");
    assert!(asked.status.success() && stderr(&asked).contains("going on without it"));
}

#[test]
fn no_server_is_one_line_and_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    drop(listener);
    let out = folder.path().join("run");
    fails_with(&["run", "--server", &address, "--out", text(&out)], &["no server", &address]);
    assert!(!out.exists());
}

#[test]
fn a_server_that_never_answers_init_is_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("quick.toml");
    fs::write(&config, QUICK).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let server = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        // Takes everything until the client has gone.
        std::io::copy(&mut stream, &mut std::io::sink()).unwrap();
    });
    let out = folder.path().join("run");
    fails_with(
        &["run", "--server", &address, "--config", text(&config), "--out", text(&out)],
        &["no STA", "USARBot.P3AT", &address],
    );
    server.join().unwrap();
    assert!(out.join("session.usar").exists(), "a run is always recorded");
}

#[test]
fn a_scenario_with_a_missing_map_and_a_misspelt_key_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = folder.path().join("s.toml");
    let head = "map = \"gone.toml\"\n[[robot]]\nname = \"R1\"\nclass = \"USARBot.P3AT\"\n";
    fs::write(&scenario, head).unwrap();
    fails_with(&["mission", text(&scenario)], &["names map", "gone.toml", "No such file"]);
    for arguments in [&["sim", "--port", "0"][..], &["check", "--rig"], &["info"], &["mission"]] {
        let output = usar(&[arguments, &[text(&scenario)]].concat());
        assert_eq!(stderr(&output).matches("No such file").count(), 1, "{}", stderr(&output));
    }
    fs::write(&scenario, "map = \"gone.toml\"\n[agent.mission]\nsetle_s = 1.0\n").unwrap();
    let checked = usar(&["check", text(&scenario)]);
    for part in ["`settle_s`", "names map", "at least one robot"] {
        assert!(stderr(&checked).contains(part), "{part}: {}", stderr(&checked));
    }
    fs::write(&scenario, head.replace("class", "clas")).unwrap();
    fails_with(&["mission", text(&scenario)], &["s.toml:4", "`clas`", "did you mean `class`"]);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let box_map = root.join("maps/box.toml");
    let agent = "[agent.mission]\nsetle_s = 1.0\n";
    fs::write(&scenario, format!("{}{agent}", head.replace("gone.toml", text(&box_map)))).unwrap();
    fails_with(&["sim", "--port", "0", text(&scenario)], &["s.toml:6", "`settle_s`"]);
    let config = folder.path().join("c.toml");
    fails_with(&["mission", "box", "--config", text(&config)], &["cannot read", "c.toml"]);
    fs::write(&config, "[mission]\nsetle_s = 1.0\n").unwrap();
    let arguments = ["mission", "box", "--config", text(&config)];
    fails_with(&arguments, &["c.toml:2", "`setle_s`", "did you mean `settle_s`"]);
}

#[test]
fn a_scan_that_is_not_organised_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("list.pcd");
    let header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\n\
                  HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n";
    fs::write(&scan, format!("{header}0 0 0\n1 0 0\n")).unwrap();
    fails_with(&["segment", text(&scan)], &["list.pcd", "not organised", "HEIGHT"]);
}

#[test]
fn a_run_is_recorded_verified_scored_and_exported() {
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = (mission(&folder, "one", "45"), mission(&folder, "two", "45"));
    let session = one.join("session.usar");
    // Two processes, one seed.
    assert!(fs::read(&session).unwrap() == fs::read(two.join("session.usar")).unwrap());

    let verified = usar(&["replay", text(&one), "--verify"]);
    assert!(verified.status.success(), "{}", stderr(&verified));
    assert!(String::from_utf8_lossy(&verified.stdout).contains("verified"));

    let bytes = fs::read(&session).unwrap();
    let cut = folder.path().join("cut.usar");
    fs::write(&cut, &bytes[..bytes.len() - 10]).unwrap();
    let verified = usar(&["replay", text(&cut)]);
    assert_eq!(verified.status.code(), Some(3), "{}", stderr(&verified));
    assert_eq!(usar(&["check", text(&cut)]).status.code(), Some(3));
    let tum = folder.path().join("cut.tum");
    let exported = usar(&["export", text(&cut), "--to", "tum", "-o", text(&tum)]);
    assert_eq!(exported.status.code(), Some(3), "{}", stderr(&exported));
    assert!(stderr(&exported).contains("not whole") && tum.exists());

    let scored = usar(&["eval", text(&one), text(&two), "--format", "json"]);
    let scores: serde_json::Value = serde_json::from_slice(&scored.stdout).unwrap();
    let report: serde_json::Value =
        serde_json::from_slice(&fs::read(one.join("report.json")).unwrap()).unwrap();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let explored = number(&scores[0]["explored_m2"]) - number(&report["explored_m2"]);
    assert!(explored.abs() < 0.5, "{explored}");
    assert!(number(&scores[1]["ate"]["rmse_m"]) < 0.2);
    assert!(number(&scores[0]["planes"]["matched"]) >= 1.0);

    let exported = |to: &str, name: &str| {
        let path = folder.path().join(name);
        let output = usar(&["export", text(&one), "--to", to, "-o", text(&path)]);
        assert!(output.status.success(), "{to}: {}", stderr(&output));
        fs::read(&path).unwrap_or_default()
    };
    assert!(exported("ply", "p.ply").starts_with(b"ply\n"));
    assert!(exported("tum", "t.tum") == fs::read(one.join("trajectory.tum")).unwrap());
    assert!(exported("png3d", "m.png").starts_with(b"\x89PNG"));
    assert!(exported("pcd", "c.pcd").windows(11).any(|w| w == b"DATA binary"));
    exported("map-server", "map");
    let yaml = fs::read_to_string(folder.path().join("map.yaml")).unwrap();
    assert!(yaml.starts_with("image: map.pgm\n") && folder.path().join("map.pgm").exists());

    // Its scans make a map of their own, in either mode, that is scored.
    exported("scans", "s");
    let (folder_s, again) = (folder.path().join("s"), folder.path().join("again"));
    let files = fs::read_dir(&folder_s).unwrap().map(|entry| entry.unwrap().path());
    let mut scans: Vec<_> = files.filter(|path| path.extension().unwrap() == "pcd").collect();
    scans.sort();
    let (way, truth) = (folder_s.join("odometry.tum"), folder_s.join("truth.tum"));
    let mut arguments = vec!["map", "--odometry", text(&way), "--truth", text(&truth)];
    arguments.extend(["--mode", "mip", "--out", text(&again)]);
    arguments.extend(scans.iter().map(|scan| text(scan)));
    let mapped = usar(&arguments);
    assert!(mapped.status.success(), "{}", stderr(&mapped));
    let scored = usar(&["eval", text(&again), "--format", "json"]);
    let score: serde_json::Value = serde_json::from_slice(&scored.stdout).unwrap();
    assert!(number(&score["ate"]["final_m"]) < 0.05, "{score}");
    // As from the run itself.
    let direct = folder.path().join("direct");
    let mapped = usar(&["map", text(&one), "--mode", "mip", "--out", text(&direct)]);
    assert!(mapped.status.success(), "{}", stderr(&mapped));
    let way_of = |run: &std::path::Path| fs::read_to_string(run.join("trajectory.tum")).unwrap();
    assert_eq!(way_of(&direct).lines().count(), way_of(&again).lines().count());
    let scored = usar(&["eval", text(&direct), "--format", "json"]);
    let score: serde_json::Value = serde_json::from_slice(&scored.stdout).unwrap();
    assert!(number(&score["ate"]["final_m"]) < 0.05, "{score}");
    assert_eq!(usar(&["map", text(&cut)]).status.code(), Some(3));
    fails_with(&["map", text(&one), text(&scans[0])], &["is a session: it is mapped alone"]);
    fails_with(&["map", text(&one), "--out", text(&two)], &["holds a recording"]);
    fails_with(&["map", text(&folder_s)], &["no run folder"]);
    // What an earlier map was scored by says nothing of another.
    let unscored = usar(&["map", text(&scans[0]), "--out", text(&direct)]);
    assert!(unscored.status.success() && !direct.join("truth.tum").exists());

    let info = usar(&["info", text(&session), "--format", "json"]);
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!((info["kind"].as_str(), info["scenario"].as_str()), (Some("session"), Some("box")));

    // A recording is never overwritten.
    let arguments = ["mission", "box", "--time-limit", "1", "--out", text(&one)];
    fails_with(&arguments, &["holds a recording", "--force"]);
}

#[test]
fn recorded_triples_of_a_session_become_a_scan_that_can_be_segmented() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("continuous.toml");
    fs::write(&config, "[mission]\nfine_sweep = \"continuous\"\n").unwrap();
    let run = folder.path().join("run");
    let arguments = ["mission", "box", "--time-limit", "60", "--config", text(&config), "--out"];
    let output = usar(&[&arguments[..], &[text(&run)]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let swept: serde_json::Value =
        serde_json::from_slice(&fs::read(run.join("report.json")).unwrap()).unwrap();
    let live = swept["sweeps"].as_array().unwrap();
    let live = live.iter().find(|sweep| sweep["profile"] == "continuous").expect("it was taken");

    // From the session to triples, and from their text to the scan.
    let (triples, scan) = (folder.path().join("triples.txt"), folder.path().join("scan.pcd"));
    let output = usar(&["scan", text(&run), "--triples", text(&triples)]);
    assert!(output.status.success(), "{}", stderr(&output));
    let checked = usar(&["check", text(&triples)]);
    assert!(String::from_utf8_lossy(&checked.stdout).contains("valid triples"));
    let output = usar(&["scan", text(&triples), "-o", text(&scan), "--format", "json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let sweep = &found["sweeps"][found["written"].as_u64().unwrap() as usize - 1];
    assert!((number(&sweep["rows"]) - number(&live["rows"])).abs() <= 3.0, "{sweep} {live}");
    assert!((number(&sweep["rate_rad_s"]).abs() - 0.05).abs() < 0.005, "{sweep}");
    assert_eq!(sweep["columns"].as_u64(), Some(181));

    // Floor and walls of the box, and none of them where the tilts are those of half a second later.
    let planes = |scan: &Path| {
        let output = usar(&["segment", text(scan), "--format", "json"]);
        assert!(output.status.success(), "{}", stderr(&output));
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let floor = |said: &str| -> f64 {
        let said: serde_json::Value = serde_json::from_str(said).unwrap();
        let surfaces = said["surfaces"].as_array().unwrap().clone();
        let level =
            surfaces.iter().filter(|s| s["kind"] == "plane" && number(&s["points"]) > 500.0);
        level.map(|s| number(&s["normal"][2]).abs()).fold(0.0, f64::max)
    };
    let in_time = floor(&planes(&scan));
    let late = folder.path().join("late.pcd");
    let arguments = ["scan", text(&triples), "--tilt-late", "0.5", "-o", text(&late)];
    assert!(usar(&arguments).status.success());
    let desynchronised = floor(&planes(&late));
    let degrees = |z: f64| z.acos().to_degrees();
    assert!(degrees(in_time) < 0.3, "{}°", degrees(in_time));
    assert!(degrees(desynchronised) > 0.8, "{}°", degrees(desynchronised));

    fs::write(&triples, "usar triples 1\n1 2 x\n").unwrap();
    fails_with(&["scan", text(&triples)], &["triples.txt", "line 2", "`x` is no number"]);
    // The same from standard input.
    let output = assert_cmd::Command::new(assert_cmd::cargo::cargo_bin!("usar"))
        .args(["scan", "-"])
        .write_stdin("usar triples 1\n1 2 x\n")
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && told.contains("line 2: `x` is no number"), "{told}");
}

#[test]
fn a_recording_with_a_changed_action_fails_its_verification() {
    use usar_agent::record::{What, Writer, read};
    let folder = tempfile::tempdir().unwrap();
    let out = mission(&folder, "run", "15");
    let mut recording = read(&fs::read(out.join("session.usar")).unwrap()).unwrap();
    let sent = recording.entries.iter_mut().rev().find_map(|entry| match &mut entry.what {
        What::Sent(line) => Some(line),
        _ => None,
    });
    *sent.unwrap() = b"DRIVE {Left 1} {Right 1} {Normalized false}\r\n".to_vec();
    let mut writer = Writer::new(Vec::new(), &recording.header).unwrap();
    for entry in &recording.entries {
        writer.push(entry).unwrap();
    }
    let changed = folder.path().join("changed.usar");
    fs::write(&changed, writer.finish().unwrap()).unwrap();
    fails_with(&["replay", text(&changed), "--verify"], &["differs", "{Left 1}", "entry"]);
}

#[test]
fn a_recording_without_its_end_is_done_with_loss() {
    use usar_agent::record::{Header, Writer};
    let folder = tempfile::tempdir().unwrap();
    let [open, closed] = ["open.usar", "closed.usar"].map(|name| folder.path().join(name));
    // What is on the disk when a run is killed: everything that was flushed.
    let writer = Writer::new(fs::File::create(&open).unwrap(), &Header::default()).unwrap();
    drop(writer);
    Writer::new(fs::File::create(&closed).unwrap(), &Header::default()).unwrap().finish().unwrap();
    let checked = usar(&["check", text(&open)]);
    assert_eq!(checked.status.code(), Some(3), "{}", stderr(&checked));
    assert!(stderr(&checked).contains("the end is missing"), "{}", stderr(&checked));
    assert!(usar(&["check", text(&closed)]).status.success());
}

#[test]
fn quiet_leaves_errors_alone_and_colour_is_for_whoever_asks() {
    let warned = ["demo", "--time-limit", "1", "--console", "x"];
    let folder = tempfile::tempdir().unwrap();
    let said = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        stderr(&usar(&[&warned[..], &["--out", text(&out)], more].concat()))
    };
    assert!(said("usual", &[]).starts_with("warning: "));
    assert_eq!(said("quiet", &["-q"]), "");
    assert!(said("colour", &["--color", "always"]).contains("\x1b[1;33mwarning:\x1b[0m"));
    assert!(!said("none", &["--color", "never"]).contains("\x1b[1"));
    let gone = usar(&["info", "gone.usar", "-q"]);
    assert!(stderr(&gone).starts_with("error: "), "{}", stderr(&gone));
    let more = usar(&["mission", "box", "--time-limit", "2", "-v", "--out", text(folder.path())]);
    assert!(stderr(&more).contains("connected; opening the session"), "{}", stderr(&more));
}

#[test]
fn a_figure_without_a_folder_goes_under_runs() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(assert_cmd::cargo::cargo_bin!("usar"));
    let output = command.args(["paper", "fig2"]).current_dir(folder.path()).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(!folder.path().join("fig2.png").exists());
    assert!(folder.path().join("runs/latest/fig2.png").exists());
}

#[test]
fn deliverables_that_are_not_built_are_misuse() {
    let folder = tempfile::tempdir().unwrap();
    for to in ["geotiff", "mcap", "mif"] {
        let output = usar(&["export", text(folder.path()), "--to", to]);
        assert_eq!(output.status.code(), Some(2));
        assert!(stderr(&output).contains("not built yet"), "{}", stderr(&output));
    }
}

#[test]
fn check_reports_every_mistake_of_every_file() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let bad = folder.path().join("bad.toml");
    fs::write(&bad, "[mission]\nsetle_s = 1.0\nguard_age = 2\n").unwrap();
    let good = root.join("scenarios/box.toml");
    let output = usar(&["check", text(&good), text(&bad), text(&root.join("maps/box.toml"))]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(errors(&output).len(), 2, "{}", stderr(&output));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("valid scenario") && said.contains("valid map"), "{said}");
}

#[test]
fn the_ground_that_a_rig_can_see_is_printed() {
    let output = usar(&["check", "--rig", "box"]);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{}", stderr(&output));
    // A laser 0.6 m above the floor that tilts by 60° sees the floor 0.35 m ahead of itself.
    assert!(said.contains("laser height   0.6") || said.contains("laser height   0.7"), "{said}");
    assert!(said.contains("nearest ground") && said.contains("blind radius"), "{said}");
}

/// A scan of a laser 0.6 m above a floor that ends at a wall so far ahead.
fn before_a_wall(wall_m: f64) -> Vec<u8> {
    use usar_agent::files::pcd::{Encoding, write_pcd};
    use usar_agent::scan::PointGrid;
    let mut points = Vec::new();
    for row in 0..120 {
        let (down, level) = (-0.4 + 0.01 * f64::from(row)).sin_cos();
        for column in 0..121 {
            let (left, ahead) = (-1.2 + 0.02 * f64::from(column)).sin_cos();
            let [x, y, z] = [ahead * level, left, -ahead * down];
            let floor = if z < -1e-3 { -0.6 / z } else { f64::INFINITY };
            let wall = if x > 1e-3 { wall_m / x } else { f64::INFINITY };
            let range = floor.min(wall);
            let hit = range < 12.0;
            let p = [x, y, z].map(|v| if hit { (v * range) as f32 } else { f32::NAN });
            points.push(p);
        }
    }
    write_pcd(&PointGrid::new(120, 121, points), Encoding::Binary)
}

#[test]
fn organised_scans_leave_a_grid_with_the_floor_free_and_the_wall_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let scan = folder.path().join("scan.pcd");
    fs::write(&scan, before_a_wall(3.0)).unwrap();
    let out = folder.path().join("map");
    let mapped = usar(&["map", text(&scan), "--out", text(&out)]);
    assert!(mapped.status.success(), "{}", stderr(&mapped));
    assert!(out.join("trajectory.tum").exists() && out.join("map.png").exists());
    let yaml = fs::read_to_string(out.join("map.yaml")).unwrap();
    let origin = yaml.lines().find_map(|line| line.strip_prefix("origin: [")).unwrap();
    let origin: Vec<f64> = origin.split(',').take(2).map(|n| n.trim().parse().unwrap()).collect();
    let pgm = fs::read(out.join("map.pgm")).unwrap();
    let head = String::from_utf8_lossy(&pgm[..20]).into_owned();
    let size: Vec<usize> =
        head.split_whitespace().skip(1).take(2).map(|n| n.parse().unwrap()).collect();
    let pixels = &pgm[pgm.len() - size[0] * size[1]..];
    let grey = |x: f64, y: f64| {
        let column = ((x - origin[0]) / 0.05) as usize;
        let row = size[1] - 1 - ((y - origin[1]) / 0.05) as usize;
        pixels[row * size[0] + column]
    };
    assert_eq!([grey(1.5, 0.0), grey(2.0, 0.7), grey(2.0, -0.7)], [254; 3], "the floor is free");
    let wall = |y: f64| (0..5).any(|i| grey(2.9 + 0.05 * f64::from(i), y) == 0);
    assert!(wall(0.0) && wall(0.8) && wall(-0.8), "the wall is there");
}

#[test]
fn what_map_writes_is_scored_and_what_is_missing_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for (name, wall_m) in [("a.pcd", 3.0), ("b.pcd", 2.7), ("c.pcd", 2.4)] {
        fs::write(path(name), before_a_wall(wall_m)).unwrap();
    }
    let poses = |step_m: f64| -> String {
        (0..3).map(|k| format!("{k} {} 0 0 0 0 0 1\n", step_m * f64::from(k))).collect()
    };
    fs::write(path("odometry.tum"), poses(0.28)).unwrap();
    fs::write(path("truth.tum"), poses(0.3)).unwrap();
    let [a, b, c] = ["a.pcd", "b.pcd", "c.pcd"].map(path);
    let (odometry, truth, out) = (path("odometry.tum"), path("truth.tum"), path("map"));
    let map = |mode: &str| {
        let scans = ["map", text(&a), text(&b), text(&c), "--odometry", text(&odometry)];
        let rest = ["--mode", mode, "--truth", text(&truth), "--out", text(&out)];
        let mapped = usar(&[&scans[..], &rest].concat());
        assert!(mapped.status.success(), "{}", stderr(&mapped));
        String::from_utf8_lossy(&mapped.stdout).into_owned()
    };
    let eval = |more: &[&str]| {
        let scored = usar(&[&["eval", text(&out), "--format", "json"], more].concat());
        assert!(scored.status.success(), "{}", stderr(&scored));
        let score: serde_json::Value = serde_json::from_slice(&scored.stdout).unwrap();
        (score, stderr(&scored))
    };

    assert!(map("full").contains("NEES"));
    let (score, said) = eval(&[]);
    assert!(said.contains("--scenario"), "planes need the world: {said}");
    assert!(score["ate"]["final_m"].as_f64().unwrap() < 0.005, "{score}");
    assert_eq!(score["nees"]["keyframes"], 2);
    assert_eq!(score["nees"]["truth_step_m"], 0.0, "round numbers, but exact");
    assert_eq!(score["associations"]["wrong"], 0);
    assert!(score["associations"]["right"].as_u64().unwrap() >= 6, "{score}");
    assert_eq!(score["step_nees"]["keyframes"], 2);

    // A truth that is named goes before the run's own; one that ends elsewhere is told.
    let other = path("other.tum");
    fs::write(&other, poses(0.5)).unwrap();
    let (score, said) = eval(&["--truth", text(&other)]);
    assert!((score["ate"]["final_m"].as_f64().unwrap() - 0.4).abs() < 0.005, "{score}");
    assert!(!said.contains("ends at"), "{said}");
    fs::write(&other, poses(0.3).lines().take(2).collect::<Vec<_>>().join("\n")).unwrap();
    let (_, said) = eval(&["--truth", text(&other)]);
    assert!(said.contains("ends at 2 s, the truth at 1 s"), "{said}");

    // Of another clock: line by line for `usar map`, which knows of nothing else, and none for `usar eval`.
    let later: String =
        (0..3).map(|k| format!("{} {} 0 0 0 0 0 1\n", 1000 + k, 0.3 * f64::from(k))).collect();
    fs::write(&other, later).unwrap();
    fails_with(
        &["eval", text(&out), "--truth", text(&other)],
        &["of 0 to 2 s", "of 1000 to 1002 s", "no time in common"],
    );
    let scans = ["map", text(&a), text(&b), text(&c), "--odometry", text(&odometry)];
    let rest = ["--truth", text(&other), "--out", text(&out)];
    assert!(usar(&[&scans[..], &rest].concat()).status.success());
    let (score, _) = eval(&[]);
    assert!(score["ate"]["final_m"].as_f64().unwrap() < 0.005, "{score}");

    let backwards = path("backwards.tum");
    fs::write(&backwards, "0 0 0 0 0 0 0 1\n5 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n").unwrap();
    let scans = ["map", text(&a), text(&b), text(&c)];
    fails_with(
        &[&scans[..], &["--odometry", text(&backwards)]].concat(),
        &["backwards.tum", "pose 3 is of 1 s, before that of 5 s"],
    );
    let broken = path("broken.tum");
    fs::write(&broken, "0 0 0 0 0 0 0 1\n1 20000 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n").unwrap();
    fails_with(
        &[&scans[..], &["--odometry", text(&broken)]].concat(),
        &["broken.tum", "pose 2 is 20000 m from the one before"],
    );

    // The paper's filter has no covariance of the motions from scan to scan, and says so instead of a number; what
    // it takes for known since the first is scored.
    assert!(map("mip").contains("no NEES"));
    let (score, _) = eval(&[]);
    assert!(score["nees"]["mean"].as_f64().unwrap() > 0.0, "{score}");
    assert!(score["step_nees"].is_null(), "{score}");
    assert!(score["associations"]["right"].as_u64().unwrap() > 0, "{score}");
    let with_truth = score["ate"].clone();

    fs::remove_file(out.join("truth.tum")).unwrap();
    let (score, said) = eval(&[]);
    assert!(said.contains("no truth.tum") && said.contains("--truth"), "{said}");
    assert!(score["ate"].is_null());
    let (score, _) = eval(&["--truth", text(&truth)]);
    assert_eq!(score["ate"], with_truth);

    fs::write(out.join("report.json"), "{}").unwrap();
    fails_with(&["eval", text(&out)], &["report.json", "usar map"]);
    fs::remove_file(out.join("report.json")).unwrap();
    fails_with(&["eval", text(&out)], &["report.json", "not a run folder"]);
}
