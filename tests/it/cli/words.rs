//! What the command line says to somebody who meets the program for the first time.
//!
//! Promise: a mistake is told by what it is, arrows point from server to client, and what happened can be
//! read afterwards.

use std::fs;

use trocar_tests::{HostProcess, Trocar, World, eventually};

use super::{OK, REFUSED, USAGE};

fn pair(world: &World) -> (HostProcess, Trocar) {
    let host = HostProcess::start(world);
    host.grpcurl().await_class("host", "Server");
    let trocar = Trocar::at(world, host.address());
    trocar.run(&["create", "host/server", "Server"]).ends_with(OK);
    trocar.run(&["create", "host/client", "Client"]).ends_with(OK);
    trocar.run(&["connect", "host/client/Required", "host/server/Provided"]).ends_with(OK);
    (host, trocar)
}

#[test]
fn globs_are_removed_all_or_nothing_and_a_stop_on_the_way_is_said() {
    let world = World::with_plugins(&["example"]);
    let (_host, trocar) = pair(&world);
    trocar.run(&["rm", "host/*"]).ends_with(REFUSED).says("host/server/Provided → host/client/Required");
    trocar.run(&["ls"]).says("host/client").says("host/server");
    trocar.run(&["start", "host/*"]).ends_with(OK);
    let removed = trocar.run(&["rm", "host/**", "--force"]).ends_with(OK);
    removed.says("stopped host/server").says("removed host/client, host/server");
    trocar.run(&["rm", "host/*"]).ends_with(REFUSED).says("no component matches");
    trocar.run(&["create", "host/server", "Server"]).ends_with(OK);
    trocar.run(&["start", "host/server"]).ends_with(OK);
    trocar.run(&["rm", "host/server"]).ends_with(OK).says("stopped host/server").says("removed host/server");
}

#[test]
fn arrows_point_from_server_to_client_and_a_name_that_is_not_there_is_told_as_such() {
    let world = World::with_plugins(&["example"]);
    let (_host, trocar) = pair(&world);
    let there = "there is connection 1: host/server/Provided → host/client/Required";
    trocar.run(&["disconnect", "99"]).ends_with(REFUSED).says(there);
    trocar.run(&["disconnect", "host/server/system"]).ends_with(REFUSED).says(there);
    trocar.run(&["disconnect", "host/client/Requird"]).ends_with(REFUSED).says("did you mean `Required`");
    let pair = ["disconnect", "host/client/Required", "host/server/Provide"];
    trocar.run(&pair).ends_with(REFUSED).says("did you mean `Provided`");
    trocar.run(&["connect", "host/client", "host/server"]).ends_with(REFUSED).says("it names a component");
}

#[test]
fn a_member_of_another_kind_is_not_called_missing() {
    let world = World::with_plugins(&["example"]);
    let (_host, trocar) = pair(&world);
    let read = "host/server/Provided/Read";
    trocar
        .run(&["echo", read])
        .ends_with(REFUSED)
        .says("is a read command, not an event")
        .says("trocar call");
    let event = "host/server/Provided/SetPointReached";
    trocar.run(&["call", event]).ends_with(REFUSED).says("is an event, not a command").says("trocar echo");
    trocar.run(&["describe", "example/Srver"]).ends_with(REFUSED).says("there is example/Server");
    trocar.run(&["describe", "host/server"]).ends_with(OK).says("class example/Server, version ");
    trocar.run(&["stop"]).ends_with(USAGE).says("trocar stop --all");
}

#[test]
fn a_list_of_what_is_not_there_is_refused_and_a_part_shows_that_part() {
    let world = World::with_plugins(&["example"]);
    let (_host, trocar) = pair(&world);
    trocar.run(&["ls", "nothing/*"]).ends_with(REFUSED).says("no component matches").says("host/client");
    let part = trocar.run(&["ls", "host/s*"]).ends_with(OK).says("host/server");
    assert!(!part.stdout.contains("Classes"), "{part:#?}");
    trocar.run(&["ls", "**"]).ends_with(OK).says("host/client");
    trocar.run(&["ls", "host"]).ends_with(OK).says("2 classes to make components of: `trocar ls --classes`");
    trocar.run(&["ls", "host", "--classes"]).ends_with(OK).says("example/Server");
}

#[test]
fn what_the_host_itself_did_and_refused_is_in_the_log_which_can_be_cut_short() {
    let world = World::with_plugins(&["example"]);
    fs::write(world.plugins().join("libtrocar_bad.so"), "no library").unwrap();
    let (_host, trocar) = pair(&world);
    trocar.run(&["start", "host/nobody"]).ends_with(REFUSED);
    let said = ["host registered", "libtrocar_bad.so", "\"create\"", "refused: COMPONENT_NOT_FOUND"];
    eventually("the log has it", || {
        let log = trocar.run(&["logs"]).stdout;
        if said.iter().all(|text| log.contains(text)) { Ok(()) } else { Err(log) }
    });
    let newest = trocar.run(&["logs", "-n", "1"]).ends_with(OK).says("refused: COMPONENT_NOT_FOUND");
    assert_eq!(newest.stdout.lines().count(), 1, "{newest:#?}");
    trocar.run(&["logs", "host"]).ends_with(OK).says("\"create\"");
}

#[test]
fn rewiring_a_healthy_component_leaves_it_healthy_and_cutting_an_actuator_off_is_said() {
    let world = World::with_plugins(&["eyerobot", "fixture_conform"]);
    let host = HostProcess::start(&world);
    host.grpcurl().await_class("host", "joint_mover");
    let trocar = Trocar::at(&world, host.address());
    for (path, class) in [("host/a", "eyerobot"), ("host/b", "eyerobot"), ("host/mover", "joint_mover")] {
        trocar.run(&["create", path, class]).ends_with(OK);
    }
    trocar.run(&["connect", "host/mover/robot", "host/a/arm"]).ends_with(OK);
    trocar.run(&["start", "host/*"]).ends_with(OK);
    for server in ["host/b/arm", "host/a/arm", "host/b/arm", "host/a/arm"] {
        let rewired = trocar.run(&["connect", "--replace", "host/mover/robot", server]).ends_with(OK);
        assert!(!rewired.stdout.contains("STALE_INPUT"), "{rewired:#?}");
    }
    trocar.run(&["configure", "host/a", "--max-step", "5ms"]).ends_with(REFUSED).says("without a period");
    host.grpcurl().await_class("host", "Arm");
    trocar.run(&["create", "host/s", "fixture-conform/Server"]).ends_with(OK);
    trocar.run(&["create", "host/arm", "fixture-conform/Arm"]).ends_with(OK);
    trocar.run(&["connect", "host/arm/drive", "host/s/ctl"]).ends_with(OK);
    trocar.run(&["connect", "host/arm/set_point", "host/s/value_out"]).ends_with(OK);
    trocar.run(&["start", "host/s", "host/arm"]).ends_with(OK);
    let dry = trocar.run(&["disconnect", "host/arm/drive", "--dry-run"]).ends_with(OK);
    assert!(!dry.stderr.contains("warning"), "{dry:#?}");
    trocar.run(&["disconnect", "host/arm/drive"]).ends_with(OK).says("requires drive").says("made safe");
}
