//! The filters of `filters`, all in one host behind each other, and what they do when what they need is wrong
//! or ceases.

use serde_json::{Value, json};

use super::{OK, REFUSED, Site};

/// Eight filters between two generators and a robot: name, class.
const FILTERS: [(&str, &str); 8] = [
    ("smooth", "biquad"),
    ("median", "moving_median"),
    ("track", "kalman"),
    ("even", "resampler"),
    ("late", "add_latency"),
    ("control", "pid"),
    ("dog", "watchdog"),
    ("turned", "cartesian_transform"),
];

/// Generators `wanted` and `is`, and all filters behind them and the robot; nothing runs yet.
fn all() -> Site {
    let site = Site::with(&["filters", "sine", "eyerobot"]);
    let grpc = &site.grpc;
    grpc.create("host/wanted", "sine", json!({ "amplitude": 0.5 }));
    grpc.create("host/is", "sine", json!({ "amplitude": 0.2 }));
    grpc.create("host/robot", "eyerobot", json!({}));
    for (name, class) in FILTERS {
        grpc.create(&format!("host/{name}"), &format!("filters/{class}"), json!({}));
    }
    for (client, server) in [
        ("late/sample", "is/value"),
        ("control/setpoint", "wanted/value"),
        ("control/measured", "late/delayed"),
        ("smooth/value", "control/command"),
        ("median/value", "smooth/filtered"),
        ("track/value", "median/filtered"),
        ("even/value", "median/filtered"),
        ("even/pose", "robot/measured_cp"),
        ("turned/pose", "even/resampled_pose"),
        ("dog/watched", "is/value"),
        ("dog/device", "robot/arm"),
    ] {
        grpc.connect(&format!("host/{client}"), &format!("host/{server}"));
    }
    site
}

impl Site {
    /// The newest sample of an output.
    fn sample(&self, output: &str) -> Value {
        self.grpc.ok("InteractService/Read", json!({ "path": output }))["json"].clone()
    }
}

#[test]
fn all_filters_run_behind_each_other_and_behind_a_robot() {
    let site = all();
    site.configure("host/turned", &json!({ "translation_m": [1, 0, 0], "rotation": [0, 0, 1, 0] }));
    site.trocar().run(&["start", "host/*"]).ends_with(OK);
    for (name, _) in FILTERS {
        assert_eq!(site.grpc.state(&format!("host/{name}")), "ACTIVE");
    }
    site.until("host/control", "it controls", |row| row["controls"] == true);
    site.until("host/dog", "data come", |row| row["alive"] == true && row["data_lost"] == false);
    for output in ["smooth/filtered", "median/filtered", "even/resampled", "control/command"] {
        let sample = site.sample(&format!("host/{output}"));
        let value = sample["value"].as_f64().unwrap();
        assert!(value.abs() <= 1.0 && sample["stamp"].as_u64() > Some(0), "{output}: {sample}");
    }
    site.until("host/smooth", "its rate is known", |row| row["value_hz"].as_f64() > Some(0.0));
    site.unfit(
        "host/smooth",
        &json!({ "frequency_hz": 600 }),
        "COMPONENT_REFUSED",
        "frequency_hz: 600 Hz is not below half the rate of the samples",
    );
    let estimate = site.sample("host/track/estimate");
    assert!(estimate["sigma"].as_f64() > Some(0.0), "{estimate}");
    // Half a turn about z and a metre: the tip at 120 mm.
    let tip = site.sample("host/turned/transformed");
    let at = [0, 1, 2].map(|i| tip["position"][i].as_f64().unwrap());
    assert!((at[0] - 1.0).abs() < 1e-5 && at[1].abs() < 1e-5 && (at[2] - 0.12).abs() < 1e-5, "{tip}");
    for (name, _) in FILTERS {
        let row = site.row(&format!("host/{name}"));
        assert!(row["rejected"].as_u64().unwrap_or(0) == 0, "{name}: {row}");
    }
}

#[test]
fn a_source_that_ceases_ends_the_control_and_lets_the_robot_hold_until_it_comes_again() {
    let site = all();
    site.configure("host/control", &json!({ "safe": 0.25 }));
    // So long that data which only came late on a busy machine do not count as lost.
    site.configure("host/dog", &json!({ "timeout_s": 1 }));
    site.configure("host/robot", &json!({ "speed_m_s": 0.002 }));
    site.trocar().run(&["start", "host/*"]).ends_with(OK);
    site.until("host/control", "it controls", |row| row["controls"] == true);
    site.until("host/dog", "data come", |row| row["alive"] == true);
    let mut told = site.grpc.stream(
        "InteractService/Subscribe",
        &json!({ "selections": [
        { "path": "host/dog" }, { "path": "host/dog/ctl/lost" }, { "path": "host/dog/ctl/found" } ] }),
    );
    told.until("the state", |item| item["path"] == "host/dog");
    // A way of 25 s for a robot of 2 mm/s.
    site.grpc.invoke("host/robot/arm/move_jp", json!({ "position": [0.05, 0, 0, 0, 0] }));
    site.until("host/robot", "it moves", |row| row["operating_state"]["is_busy"] == true);
    site.grpc.stop("host/is");
    let age_s = told.until("lost", |item| item["path"] == "host/dog/ctl/lost")["json"].as_f64().unwrap();
    assert!(age_s > 1.0, "{age_s}");
    let robot = site.until("host/robot", "it holds", |row| row["operating_state"]["is_busy"] == false);
    let x_m = robot["measured_js"]["position"][0].as_f64().unwrap();
    assert!(x_m < 0.045, "far from the goal: {x_m} m");
    let row = site.until("host/control", "no control", |row| row["controls"] == false);
    assert_eq!((&row["output"], &row["integral"]), (&json!(0.25), &json!(0)), "{row}");
    // What it gives goes on, is the safe output, and says when it was given.
    let command = site.sample("host/control/command");
    assert!(command["value"] == 0.25 && command["stamp"].as_u64() > Some(0), "{command}");
    assert_eq!(site.row("host/late")["waiting"], 0);
    site.until("host/dog", "it tells the robot again and again", |row| row["holds"].as_u64() > Some(2));

    site.grpc.start("host/is");
    told.until("found", |item| item["path"] == "host/dog/ctl/found");
    site.until("host/control", "it controls again", |row| row["controls"] == true);
    let dog = site.row("host/dog");
    assert_eq!((&dog["losses"], &dog["alive"]), (&json!(1), &json!(true)), "{dog}");
    // A source that is taken away altogether: the same.
    site.grpc.ok("GcmService/Remove", json!({ "path": "host/is", "force": true }));
    site.until("host/control", "no control", |row| row["controls"] == false && row["output"] == 0.25);
    site.until("host/dog", "lost", |row| row["data_lost"] == true);
}

#[test]
fn settings_that_make_no_filter_are_refused_with_the_figures_that_would() {
    let site = all();
    let component = |name: &str, config: Value, words: &str| {
        site.unfit(&format!("host/{name}"), &config, "COMPONENT_REFUSED", words);
    };
    component("median", json!({ "window": 4 }), "window: 4 is even: an odd number of samples has a median");
    component("even", json!({ "ahead_s": 2 }), "2 s ahead is longer than a sample is held, 0.5 s");
    component("control", json!({ "lowest": 2 }), "lowest, highest: 2 is not below 1");
    component("control", json!({ "safe": 7 }), "safe: 7 is not between lowest, -1, and highest, 1");
    component(
        "turned",
        json!({ "rotation": [0, 0, 0, 2] }),
        "rotation: its norm is 2; give a unit quaternion x, y, z, w",
    );
    component("late", json!({ "depth": 65536, "max_bytes": 65536 }), "are more than 256 MiB: lower one");
    let setting = |name: &str, config: Value, words: &str| {
        site.unfit(&format!("host/{name}"), &config, "CONFIG_INVALID", words);
    };
    setting(
        "smooth",
        json!({ "kind": "comb" }),
        r#"kind: "comb" is none of "low_pass", "high_pass", "band_pass", "notch""#,
    );
    setting("track", json!({ "sigma": 0 }), "sigma: 0 is below");
    setting("control", json!({ "kp": "NaN" }), r#"kp: "NaN" is not a number"#);
    setting("dog", json!({ "timeout_s": 0 }), "timeout_s: 0 s is below 0.0001 s");
    setting("late", json!({ "delay_s": 100 }), "delay_s: 100 s is above 60 s");
    setting("median", json!({ "windw": 5 }), "did you mean window?");
    // Two that do not fit each other.
    let body = json!({ "client": "host/track/pose", "server": "host/robot/state" });
    let refused = site.grpc.refused("GcmService/Connect", body);
    assert!(
        refused.reason == "TYPE_MISMATCH" && refused.message.contains("it is Pose here and ArmState there"),
        "{refused}"
    );
}

#[test]
fn the_truth_is_refused_to_whatever_leads_to_the_robot_whichever_way_round_it_is_connected() {
    let site = Site::with(&["filters", "eyerobot", "oct", "picture_writer", "force_sensor"]);
    let grpc = &site.grpc;
    for (name, class) in [
        ("robot", "eyerobot"),
        ("oct", "oct_source"),
        ("dog", "watchdog"),
        ("late", "add_latency"),
        ("plot", "plot"),
        ("force", "force_sensor"),
    ] {
        grpc.create(&format!("host/{name}"), class, json!({}));
    }
    let refused = |client: &str, server: &str| {
        let refused = grpc.refused("GcmService/Connect", json!({ "client": client, "server": server }));
        assert_eq!(refused.reason, "TRUTH_TO_ACTUATOR", "{refused}");
        refused.message
    };
    // A plot may be told, and simulated devices tell each other.
    grpc.connect("host/plot/a", "host/oct/true_distance");
    grpc.connect("host/oct/tip", "host/robot/tip");
    grpc.connect("host/force/tip", "host/robot/tip");
    grpc.connect("host/dog/device", "host/robot/arm");
    let way = "is tagged truth, and what it tells `host/dog/watched` would reach an actuator: `host/dog` → `host/robot`";
    assert!(refused("host/dog/watched", "host/oct/true_distance").contains(way));
    assert!(refused("host/dog/watched", "host/robot/tip").contains("is tagged sim"));
    let words = ["connect", "host/dog/watched", "host/oct/true_distance"];
    site.trocar().run(&words).ends_with(REFUSED).says("Recorders, plots and tests may be told the truth");
    site.trocar().run(&[&words[..], &["--dry-run"]].concat()).ends_with(REFUSED).says("is tagged truth");
    // The other way round: first the truth, then the actuator.
    grpc.ok("GcmService/Disconnect", json!({ "client": "host/dog/device", "server": "host/robot/arm" }));
    grpc.connect("host/dog/watched", "host/oct/true_distance");
    assert!(refused("host/dog/device", "host/robot/arm").contains(way));
    // And everybody may ask for it.
    site.call("host/oct/truth/distance", &Value::Null).ends_with(OK);
    site.call("host/robot/truth/measured_cp", &Value::Null).ends_with(OK);
}
