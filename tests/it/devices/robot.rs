//! The robot: its states, its limits, the hand on its handle, and the planes that it does not cross.

use serde_json::{Value, json};

use super::{OK, REFUSED, Site};

const ARM: &str = "host/robot/arm";

/// One robot that runs.
fn robot() -> Site {
    let site = Site::with(&["eyerobot", "force_sensor"]);
    site.grpc.create("host/robot", "eyerobot", json!({ "dead_band_n": 0.01 }));
    site.grpc.start("host/robot");
    site
}

impl Site {
    fn state_of_the_arm(&self) -> Value {
        self.grpc.invoke(&format!("{ARM}/operating_state"), json!(null))["state"].clone()
    }

    /// Moves the joints, m and rad, and waits for the end; whether it arrived.
    fn moved_to(&self, joints: [f64; 5]) -> bool {
        let goal = json!({ "position": joints });
        let arrived = self.event_of(&format!("{ARM}/goal_reached"), &format!("{ARM}/move_jp"), &goal);
        arrived.as_bool().unwrap()
    }

    /// Where the encoders say that the tip is, m.
    fn tip_m(&self) -> [f64; 3] {
        let pose = self.grpc.invoke(&format!("{ARM}/measured_cp"), json!(null));
        [0, 1, 2].map(|i| pose["position"][i].as_f64().unwrap())
    }
}

#[test]
fn a_wait_for_a_move_that_is_held_is_no_success() {
    let site = robot();
    let goal = |x: f64| json!({ "position": [x, 0.0, 0.0, 0.0, 0.0] });
    assert!(site.moved_to([0.001, 0.0, 0.0, 0.0, 0.0]), "a move that arrives is one");
    assert!(site.moved_to([0.001, 0.0, 0.0, 0.0, 0.0]), "so is one to where it is");
    site.grpc.invoke(&format!("{ARM}/move_jp"), goal(0.04));
    let (event, hold) = (format!("{ARM}/goal_reached"), format!("{ARM}/hold"));
    let held = site.trocar().run(&["wait", &event, "--call", &hold]);
    held.ends_with(REFUSED).says("false").says("without success");
}

#[test]
fn every_state_that_crtk_lets_a_client_reach_is_reached_by_calls_and_told() {
    let site = robot();
    let words = ["enable", "disable", "pause", "resume"];
    // Rows: from which state; columns: what `words` lead to, "" where they are refused.
    let table = [
        ("DISABLED", vec!["disable"], ["ENABLED", "DISABLED", "", ""]),
        ("ENABLED", vec!["disable", "enable"], ["ENABLED", "DISABLED", "PAUSED", ""]),
        ("PAUSED", vec!["disable", "enable", "pause"], ["", "DISABLED", "PAUSED", "ENABLED"]),
    ];
    let command = format!("{ARM}/state_command");
    for (from, way, leads) in table {
        for (word, to) in words.iter().zip(leads) {
            way.iter().for_each(|word| {
                site.grpc.invoke(&command, json!(word));
            });
            assert_eq!(site.state_of_the_arm(), from);
            match to {
                "" => site.refuses(
                    &command,
                    &json!(word),
                    "COMMAND_FAILED",
                    &format!("while the device is {from}"),
                ),
                to if to == from => assert_eq!(site.grpc.invoke(&command, json!(word)), Value::Null),
                to => {
                    // One name is a read and an event.
                    let told = site.event_of(&format!("{ARM}/operating_state"), &command, &json!(word));
                    assert_eq!(told["state"], to, "{from} {word}");
                }
            }
            assert_eq!(site.state_of_the_arm(), if to.is_empty() { from } else { to }, "{from} {word}");
        }
    }
    // FAULT is entered by the device alone; no word leads there, and motions say what to send first.
    site.refuses(
        &command,
        &json!("fault"),
        "COMMAND_FAILED",
        "CRTK has enable disable pause resume home unhome",
    );
    for (words, first) in [(vec!["disable"], "`enable`"), (vec!["enable", "pause"], "`resume`")] {
        words.iter().for_each(|word| {
            site.grpc.invoke(&command, json!(word));
        });
        let goal = json!({ "position": [0, 0, 0, 0, 0] });
        site.refuses(
            &format!("{ARM}/move_jp"),
            &goal,
            "COMMAND_FAILED",
            &format!("send state_command {first} first"),
        );
    }
    site.call(&command, &json!("resume")).ends_with(OK);
    site.call(&command, &json!("unhome")).ends_with(OK);
    let goal = json!({ "position": [0, 0, 0, 0, 0] });
    site.refuses(&format!("{ARM}/servo_jp"), &goal, "COMMAND_FAILED", "send state_command `home`");
    assert_eq!(site.event_of(&format!("{ARM}/operating_state"), &command, &json!("home"))["is_busy"], true);
    site.until("host/robot", "homed", |row| row["operating_state"]["is_homed"] == true);
    site.call(&format!("{ARM}/operating_state/x"), &json!(null)).ends_with(REFUSED).says("too many parts");
}

#[test]
fn what_is_beyond_a_limit_or_no_number_is_refused_by_the_limits_name_and_moves_nothing() {
    let site = robot();
    let twist = |linear: Value, angular: Value| json!({ "linear": linear, "angular": angular });
    let pose =
        |position: Value, orientation: Value| json!({ "position": position, "orientation": orientation });
    let none = || json!([0, 0, 0]);
    let straight = || json!([0, 0, 0, 1]);
    let before = site.tip_m();
    for (member, arg, words) in [
        (
            "servo_jp",
            json!({ "position": [0, 0, 0.06, 0, 0] }),
            "joint z: 0.06 m is outside -0.050000 … 0.050000 m",
        ),
        (
            "move_jp",
            json!({ "position": [0, 0, 0, 0, -0.8] }),
            "joint tilt: -0.8 rad is outside -0.785398 … 0.785398 rad",
        ),
        (
            "interpolate_jp",
            json!({ "position": [0, 0, 0] }),
            "3 joint values given, this arm has 5 (x, y, z, roll, tilt)",
        ),
        ("servo_jp", json!({ "position": [0, 0, "NaN", 0, 0] }), "joint z: NaN is not a finite number"),
        ("move_jr", json!({ "position": ["-Infinity", 0, 0, 0, 0] }), "joint x: -inf is not a finite number"),
        ("move_jr", json!({ "position": [0.07, 0, 0, 0, 0] }), "joint x: 0.07"),
        (
            "servo_jv",
            json!({ "velocity": [0.02, 0, 0, 0, 0] }),
            "joint x: 0.02 m/s is faster than its limit of 0.010000 m/s",
        ),
        ("servo_jv", json!({ "velocity": [0, 0, 0, "NaN", 0] }), "joint roll: NaN is not a finite number"),
        ("servo_cv", twist(json!([0.008, 0.008, 0]), none()), "is above its limit of 0.01 m/s"),
        (
            "servo_cv",
            twist(none(), json!([0, 1, 0])),
            "angular speed of the tip: 1 rad/s is above its limit of 0.122",
        ),
        ("servo_cv", twist(json!(["NaN", 0, 0]), none()), "linear[0] is NaN: give a finite number"),
        ("servo_cp", pose(json!([0, 0, 0.2]), straight()), "the pose is out of reach: joint z: 0.08"),
        (
            "move_cp",
            pose(json!([0, 0, 0.12]), json!([0, 0, 0, 0])),
            "is no unit quaternion x, y, z, w: normalise it",
        ),
        (
            "move_cp",
            pose(json!([0, "Infinity", 0.12]), straight()),
            "position[1] is inf: give a finite number",
        ),
    ] {
        site.refuses(&format!("{ARM}/{member}"), &arg, "COMMAND_FAILED", words);
    }
    let wrench = |force: Value, torque: Value| json!({ "force": force, "torque": torque });
    let compliance = "host/robot/compliance";
    let force = format!("{compliance}/servo_cf");
    site.refuses(
        &force,
        &wrench(json!([30, 0, 0]), none()),
        "COMMAND_FAILED",
        "30 N is above its limit of 20 N",
    );
    site.refuses(
        &force,
        &wrench(none(), json!([0, 0, 2])),
        "COMMAND_FAILED",
        "2 N·m is above its limit of 1 N·m",
    );
    site.refuses(&force, &wrench(json!([0, "NaN", 0]), none()), "COMMAND_FAILED", "force[1] is NaN");
    let gain = format!("{compliance}/set_gain");
    site.refuses(
        &gain,
        &json!([0.1, 0, 0, 0, 0, 0]),
        "COMMAND_FAILED",
        "gain[0]: 0.1 m/(s·N) is outside 0 … 0.005 m/(s·N)",
    );
    site.refuses(&gain, &json!([0, 0, 0]), "ARGUMENT_INVALID", "it has 3 items; exactly 6 are wanted");
    let half = json!({ "linear": [0, 0, 0] });
    site.refuses(&format!("{ARM}/servo_cv"), &half, "ARGUMENT_INVALID", "`angular` of Twist is missing");
    let moved: f64 = site.tip_m().iter().zip(before).map(|(now, before)| (now - before).abs()).sum();
    assert!(moved < 2e-6, "{moved} m");

    // A velocity may lead to a limit and not beyond it; which one is told.
    site.grpc.stop("host/robot");
    site.configure("host/robot", &json!({ "travel_m": 0.002, "servo_timeout_s": 10 }));
    site.grpc.start("host/robot");
    let velocity = json!({ "velocity": [0, 0.01, 0, 0, 0] });
    assert_eq!(
        site.event_of(&format!("{ARM}/limit_hit"), &format!("{ARM}/servo_jv"), &velocity),
        1,
        "joint y"
    );
    let row = site.until("host/robot", "it stands", |row| row["setpoint_js"]["velocity"][1] == 0.0);
    let y_m = row["measured_js"]["position"][1].as_f64().unwrap();
    assert!((y_m - 0.002).abs() < 20e-6, "{y_m} m");
    assert_eq!(site.state_of_the_arm(), "ENABLED");
}

#[test]
fn a_plane_holds_the_tip_until_it_is_taken_away_and_one_beyond_the_tip_is_refused() {
    let site = robot();
    let set = "host/robot/virtual_fixture/set";
    // What the arguments are made of is told where the command is asked for.
    let described = site.trocar().run(&["describe", set]).ends_with(OK);
    described.says("PLANE | LINE | RCM").says(".orientation: [f64; 4]").says(".stiffness: f64 [1/s]");
    // Its z points up, away from the eye: 500 µm below the tip, which stands at 120 mm.
    let plane = |kind: Value, z_m: Value, stiffness: f64| {
        let frame = json!({ "position": [0, 0, z_m], "orientation": [1, 0, 0, 0] });
        json!({ "fixtures": [{ "kind": kind, "frame": frame, "stiffness": stiffness }] })
    };
    let failed = |arg: Value, words: &str| site.refuses(set, &arg, "COMMAND_FAILED", words);
    failed(
        plane(json!(7), json!(0.1205), 0.0),
        "fixture 0: kind 7 is none; there are PLANE = 1, LINE = 2, RCM = 3",
    );
    failed(
        plane(json!("PLANE"), json!(0.1205), 90.0),
        "fixture 0: a stiffness of 90 /s is outside 0 … 30 /s",
    );
    failed(
        plane(json!("PLANE"), json!(0.119), 0.0),
        "the tip is beyond the plane by 1.000 mm; bring it within 0.1 mm first",
    );
    failed(plane(json!("PLANE"), json!("NaN"), 0.0), "position[2] is NaN");
    let cube = plane(json!("CUBE"), json!(0.1205), 0.0);
    site.refuses(set, &cube, "ARGUMENT_INVALID", "FixtureKind has no value `CUBE`; it has PLANE, LINE, RCM");
    assert_eq!(site.row("host/robot")["fixtures"]["fixtures"], json!([]), "none of them holds");

    site.grpc.invoke(set, plane(json!("PLANE"), json!(0.1205), 0.0));
    assert!(!site.moved_to([0.0, 0.0, 0.002, 0.0, 0.0]), "it does not arrive behind the plane");
    let z_m = site.tip_m()[2];
    assert!((z_m - 0.1205).abs() < 10e-6, "{z_m} m: it is held at the plane");
    site.call(set, &json!({ "fixtures": [] })).ends_with(OK);
    assert!(site.moved_to([0.0, 0.0, 0.002, 0.0, 0.0]), "nothing holds it any more");
    let z_m = site.tip_m()[2];
    assert!((z_m - 0.122).abs() < 10e-6, "{z_m} m");
}

/// The sclera pulls at the shaft of a tool that went sideways; felt at the handle, it leads the arm back.
#[test]
fn a_force_sensor_on_the_handle_leads_the_arm_and_one_that_stops_leads_it_no_more() {
    let site = robot();
    site.grpc.create("host/force", "force_sensor", json!({ "site": "sclera" }));
    site.grpc.connect("host/force/tip", "host/robot/tip");
    site.grpc.connect("host/robot/handle", "host/force/wrench");
    let gain = json!([0.005, 0.005, 0.005, 0, 0, 0]);
    site.call("host/robot/compliance/set_gain", &gain).ends_with(OK);
    site.grpc.start("host/force");
    let force_n = |row: &Value| row["felt_cf"]["force"][0].as_f64().unwrap();

    assert!(site.moved_to([0.003, 0.0, 0.0, 0.0, 0.0]));
    // 20 mN/mm against the way it went.
    site.until("host/robot", "the handle is felt", |row| (force_n(row) + 0.06).abs() < 0.01);
    site.call(&format!("{ARM}/free"), &Value::Null).ends_with(OK);
    let row = site
        .until("host/robot", "it gives way", |row| row["measured_cp"]["position"][0].as_f64() < Some(0.0025));
    assert_eq!(row["operating_state"]["state"], "ENABLED");

    site.grpc.stop("host/force");
    site.until("host/robot", "nobody is at the handle", |row| row["felt_cf"]["stamp"] == 0);
    site.until("host/robot", "it stands", |row| {
        let speed = |i: usize| row["setpoint_js"]["velocity"][i].as_f64().unwrap().abs();
        (0..5).map(speed).sum::<f64>() < 1e-9
    });
    site.call(&format!("{ARM}/hold"), &Value::Null).ends_with(OK);
    // And back again: what is felt at rest can be taken as zero.
    site.grpc.start("host/force");
    site.until("host/force", "it measures", |row| row["wrench"]["force"][0].as_f64() < Some(-0.02));
    site.trocar().run(&["wait", "host/force", "--state", "ACTIVE"]).ends_with(OK);
    let zeroed =
        || site.grpc.call("InteractService/Invoke", json!({ "path": "host/force/force_sensor/bias" }));
    trocar_tests::eventually("32 samples", || zeroed().map_err(|refused| refused.to_string()));
    site.until("host/force", "zero", |row| {
        row["wrench"]["force"][0].as_f64().is_some_and(|f| f.abs() < 0.005)
    });
}
