//! Lines of programs that misbehave, of datagrams and of a serial line, as typed outputs, and lines of any
//! samples.

use std::fs;
use std::io::Write;
use std::net::UdpSocket;

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use serde_json::{Value, json};
use trocar_tests::{HostProcess, World, eventually, repository};

use super::{OK, REFUSED, Site};

/// A source of `force` whose program is a line for the shell.
fn shell(line: &str, more: &Value) -> Value {
    let mut config =
        json!({ "program": ["/bin/sh", "-c", line], "outputs": ["force: fx N, fy N"], "restart": "never" });
    config.as_object_mut().unwrap().extend(more.as_object().cloned().unwrap());
    config
}

fn site() -> Site {
    let site = Site::with(&["lines", "filters"]);
    site.grpc.create("host/in", "lines_source", shell("exec sleep 1000", &json!({})));
    site
}

/// Runs a program until its row is as wanted; the component is ACTIVE in the end, whatever its program did.
fn run(site: &Site, line: &str, more: &Value, what: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    site.configure("host/in", &shell(line, more));
    site.grpc.start("host/in");
    let row = site.until("host/in", what, wanted);
    assert_eq!(site.grpc.state("host/in"), "ACTIVE", "{line}");
    site.grpc.stop("host/in");
    row
}

fn count(row: &Value, column: &str) -> u64 {
    trocar_tests::number(&row["taken"][column])
}

fn says(row: &Value, column: &str, words: &str) -> bool {
    let text = if column == "last_bad" { &row["last_bad"] } else { &row["operating_state"]["message"] };
    text.as_str().is_some_and(|text| text.contains(words))
}

#[test]
fn a_program_that_floods_stalls_dies_or_prints_what_is_no_line_ends_nothing() {
    let site = site();
    let none = json!({});
    let flood = run(&site, "exec yes '1 2'", &none, "a flood", |row| count(row, "dropped") > 1000);
    assert_eq!((count(&flood, "bad"), &flood["operating_state"]["state"]), (0, &json!("ENABLED")));
    run(&site, "echo 1 2; exec sleep 1000", &json!({ "stale_s": 0.2 }), "it is stale", |row| {
        row["stale"] == true && count(row, "handed_on") == 1
    });
    run(&site, "echo 1 2; echo no sensor >&2; exit 3", &none, "it has died", |row| {
        says(row, "message", "sh ended (exit status: 3): no sensor")
    });
    let again = json!({ "restart": "always", "restart_delay_s": 0.01 });
    run(&site, "echo 1 2; kill -9 $$", &again, "it was run again", |row| count(row, "failures") >= 3);
    let binary =
        run(&site, "head -c 100000 /dev/urandom; echo; echo 1 2; exec sleep 1000", &none, "binary", |row| {
            count(row, "handed_on") >= 1 && row["last_bad"] != ""
        });
    assert!(count(&binary, "bad") > 0);
    run(&site, "echo 1 2; printf 3", &none, "half a line", |row| {
        says(row, "last_bad", "the source ended in the middle of it: \"3\"") && count(row, "handed_on") == 1
    });
    run(
        &site,
        "head -c 1000000 /dev/zero | tr '\\0' x; echo; echo 1 2; exec sleep 1000",
        &none,
        "no end",
        |row| {
            says(row, "last_bad", "longer than 65536 B")
                && count(row, "handed_on") == 1
                && count(row, "bad") == 1
        },
    );
}

#[test]
fn what_a_line_is_described_as_is_seen_from_outside() {
    let site = site();
    let program = "while echo 1 2; do sleep 0.01; done";
    site.configure("host/in", &shell(program, &json!({})));
    let described = site.trocar().run(&["describe", "host/in/force"]).ends_with(OK);
    described.says("fx").says("N");
    site.grpc.start("host/in");
    eventually("a sample is read", || {
        let read = site.grpc.ok("InteractService/Read", json!({ "path": "host/in/force" }))["json"].clone();
        if read["fx"] == 1.0 && read["fy"] == 2.0 { Ok(()) } else { Err(read.to_string()) }
    });
}

#[test]
fn an_output_with_the_fields_of_an_input_is_connected_and_another_one_is_refused() {
    let site = site();
    // The sample of the guide, `low_pass`, takes a Force of three numbers.
    site.configure(
        "host/in",
        &shell("exec sleep 1000", &json!({ "outputs": ["same: f[3] N", "other: f[3] mm"] })),
    );
    site.grpc.create("host/filter", "low_pass", json!({}));
    let other = json!({ "client": "host/filter/raw", "server": "host/in/other" });
    let refused = site.grpc.refused("GcmService/Connect", other);
    assert!(
        refused.reason == "TYPE_MISMATCH" && refused.message.contains("unit N here and unit mm there"),
        "{refused}"
    );
    site.grpc.connect("host/filter/raw", "host/in/same");
    let config = shell("exec sleep 1000", &json!({ "outputs": ["same: f[3] mm"] }));
    site.configure("host/in", &config);
    let left = site.grpc.ok("GcmService/List", json!({}));
    assert!(left["connections"].as_array().is_none_or(|all| all.is_empty()), "the type is another: {left}");
}

#[test]
fn datagrams_and_a_serial_line_are_lines_too() {
    let site = site();
    let udp = json!({ "udp": "127.0.0.1:0", "outputs": ["force: fx N, fy N"] });
    site.grpc.create("host/udp", "lines_source", udp);
    site.grpc.start("host/udp");
    let row = site.until("host/udp", "it listens", |row| row["udp_port"] != 0);
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let to = ("127.0.0.1", trocar_tests::number(&row["udp_port"]) as u16);
    socket.send_to(b"1 2\n3 4", to).unwrap();
    site.until("host/udp", "both lines", |row| count(row, "handed_on") == 2);
    site.grpc.stop("host/udp");
    let far = json!({ "udp": "0.0.0.0:0" });
    site.unfit("host/udp", &far, "COMPONENT_REFUSED", "say \"udp_from_network\": true");

    let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&device).unwrap();
    unlockpt(&device).unwrap();
    let port = ptsname(&device, Vec::new()).unwrap().into_string().unwrap();
    site.grpc.create(
        "host/serial",
        "lines_source",
        json!({ "serial": port, "outputs": ["force: fx N, fy N"] }),
    );
    site.grpc.start("host/serial");
    let mut device = fs::File::from(device);
    device.write_all(b"5;6\r\n").unwrap();
    site.until("host/serial", "a line", |row| count(row, "handed_on") == 1);
    drop(device);
    site.until("host/serial", "it is gone", |row| row["operating_state"]["state"] == "FAULT");
}

#[test]
fn samples_of_any_type_become_lines_of_a_file() {
    let site = site();
    let file = site.world.path("force.csv");
    site.grpc.create("host/out", "lines_sink", json!({ "file": file, "inputs": ["force"] }));
    site.grpc.connect("host/out/force", "host/in/force");
    site.configure("host/in", &shell("echo 1 2; echo 3 4; exec sleep 1000", &json!({})));
    // The type stays, and so does the connection.
    site.grpc.start("host/out");
    site.grpc.start("host/in");
    site.until("host/out", "two lines", |row| trocar_tests::number(&row["given"]["written"]) == 2);
    let text = fs::read_to_string(&file).unwrap();
    let rows: Vec<&str> = text.lines().collect();
    assert_eq!(rows[0], "# t s, force.fx N, force.fy N");
    assert!(rows[1].ends_with(",1.0,2.0") && rows[2].ends_with(",3.0,4.0"), "{text}");
}

#[test]
fn the_script_of_the_page_runs_as_it_is_written() {
    let page = fs::read_to_string(repository().join("docs/LINES.md")).unwrap();
    let blocks: Vec<&str> = page.split("```").skip(1).step_by(2).collect();
    let block = |language: &str, at: usize| {
        let all: Vec<&str> = blocks.iter().filter_map(|b| b.strip_prefix(&format!("{language}\n"))).collect();
        all[at].to_owned()
    };
    let world = World::with_plugins(&["lines"]);
    assert!(block("python", 0).lines().count() <= 10);
    world.write("sensor.py", block("python", 0));
    world.write("show.py", block("python", 1));
    world.write("lab.json", block("json", 0));
    let args = ["run", "lab.json", "--listen", "127.0.0.1:0"].map(Into::into);
    // It runs in the directory of the files, as its reader does.
    let host = HostProcess::spawn(&world, "lab", &args);
    let grpc = host.grpcurl();
    eventually("the script gives samples", || {
        let row = grpc.ok("InteractService/Read", json!({ "path": "lab/sensor" }))["json"].clone();
        if count(&row, "handed_on") > 10 && count(&row, "bad") == 0 { Ok(()) } else { Err(row.to_string()) }
    });
    eventually("the other script reads them", || {
        let text = fs::read_to_string(world.path("fx.txt")).unwrap_or_default();
        if text.contains(" N\n") { Ok(()) } else { Err(format!("{text:?}")) }
    });
}

#[test]
fn a_class_that_may_start_programs_is_refused_where_that_is_not_allowed() {
    let world = World::with_plugins(&["lines"]);
    let host = HostProcess::start(&world);
    let trocar = trocar_tests::Trocar::at(&world, host.address());
    host.grpcurl().await_class("host", "lines_source");
    for class in ["lines_source", "lines_sink"] {
        trocar.run(&["create", "host/x", class]).ends_with(REFUSED).says("--allow-exec");
    }
}
