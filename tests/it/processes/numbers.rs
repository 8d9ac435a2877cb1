//! Whole numbers of 64 bits in a system file.
//!
//! Promise: the component has what the file says, to the last digit, and everything that shows its
//! configuration shows that: `run` and `up` alike.

use serde_json::{Value, json};
use trocar_tests::{HostProcess, Trocar, World};

use super::system::System;

/// 2^53 + 1 and its like: the nearest doubles are other numbers.
const FILE: &str = r#"{
  "version": 1,
  "processes": { "host": { "plugins": ["plugins"] } },
  "components": {
    "host/e": { "class": "echo", "config": {
      "exact": 9007199254740993, "signed": -9007199254740993, "several": [18446744073709551615]
    } }
  }
}"#;

/// Members of the component, each with its answer.
const HAS: [(&str, &str); 3] = [
    ("exact", "9007199254740993"),
    ("signed", "-9007199254740993"),
    ("first_of_several", "18446744073709551615"),
];

/// The running system has and shows the numbers of the file.
#[track_caller]
fn is_exact(trocar: &Trocar, world: &World, address: &str) {
    let grpc = trocar_tests::Grpcurl::new(address);
    for (member, number) in HAS {
        let path = format!("host/e/ctl/{member}");
        assert_eq!(grpc.invoke(&path, Value::Null), json!(number), "the component has {member}");
        trocar.run(&["call", &path]).ends_with(0).says(number);
    }
    let config = grpc.component("host/e")["config"].clone();
    let wanted = json!({ "exact": HAS[0].1, "signed": HAS[1].1, "several": [HAS[2].1] });
    assert_eq!(config, wanted, "GetState tells what it is configured with");
    let described = trocar.run(&["describe", "host/e"]).ends_with(0);
    let saved = world.path("saved.json");
    trocar.run(&["save", "-o", saved.to_str().unwrap()]).ends_with(0);
    let saved = std::fs::read_to_string(saved).unwrap();
    for (member, number) in HAS {
        assert!(described.stdout.contains(number), "`trocar describe` shows {member}: {}", described.stdout);
        // In a file it is the number, not a text.
        assert!(
            saved.contains(number) && !saved.contains(&format!("{number}\"")),
            "`trocar save`: {member}: {saved}"
        );
    }
    let file = world.path("system.json");
    let same = trocar.run(&["diff", file.to_str().unwrap()]).ends_with(0);
    assert!(!same.stdout.contains("exact"), "the file and what runs are one: {}", same.stdout);
}

#[test]
fn a_setting_of_64_bits_in_a_file_that_runs_is_exact_in_and_out() {
    let world = World::with_plugins(&["fixture_echo"]);
    let file = world.write("system.json", FILE);
    let args = ["run".into(), file.into(), "--listen".into(), "127.0.0.1:0".into()];
    let host = HostProcess::spawn(&world, "run", &args);
    is_exact(&Trocar::at(&world, host.address()), &world, host.address());
}

#[test]
fn a_setting_of_64_bits_in_a_file_that_is_up_is_exact_in_and_out() {
    let system = System::up_with(&["fixture_echo"], FILE, &[]);
    is_exact(&system.trocar(), &system.world, system.process.address());
}
