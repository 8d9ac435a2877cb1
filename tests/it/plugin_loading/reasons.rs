//! Reasons of a refusal that go without a change of the plugin's file: a library beside it, a licence, a
//! device.
//!
//! Promise: what its sentence says is to be done helps.

use std::fs;

use serde_json::json;
use trocar_tests::{HostProcess, Trocar, World, eventually, skip};

use super::bad_files::{compile, filter_with};
use super::refused_file;

#[test]
fn a_library_that_is_put_beside_a_plugin_is_found_and_a_host_and_check_say_so() {
    let world = World::new();
    let library = ["-shared", "-fPIC", "-Wl,-soname,libvendor_beside.so.3", "-o", "libvendor_beside.so.3"];
    compile(&world, "int vendor(void) { return 0; }", &library);
    let uses = "#include <cstdlib>\nextern \"C\" int vendor();\n\
                __attribute__((constructor)) static void need() { if (vendor()) abort(); }";
    let more = ["libvendor_beside.so.3", "-Wl,-rpath,$ORIGIN"];
    let Some(plugin) = filter_with(&world, "bringing.so", uses, &more) else {
        return skip("the plugin is made with a C++ compiler");
    };
    let host = HostProcess::start(&world);
    let (grpc, trocar) = (host.grpcurl(), Trocar::at(&world, host.address()));
    world.drop_in(&plugin);
    let (said, _) = eventually("it is refused", || refused_file(&grpc, "bringing.so"));
    assert!(said.contains("libvendor_beside.so.3") && said.contains("$ORIGIN"), "{said}");
    let dropped = world.plugins().join("bringing.so").display().to_string();
    let checked = trocar.run(&["plugin", "check", &dropped]);
    assert!(checked.code != 0 && checked.stderr.contains("libvendor_beside.so.3"), "{checked:?}");

    world.drop_in(&world.path("libvendor_beside.so.3"));

    let class = eventually("it is listed", || grpc.classes("host").pop().ok_or("not yet"));
    let checked = trocar.run(&["plugin", "check", &dropped]);
    assert_eq!(checked.code, 0, "{checked:?}");
    let inspected = trocar.run(&["plugin", "inspect", &dropped]);
    assert!(inspected.stdout.contains("brings libvendor_beside.so.3"), "{inspected:?}");
    grpc.create("host/f", &class, json!({}));
}

#[test]
fn a_plugin_that_crashed_without_its_licence_is_tried_again_by_reload() {
    let world = World::new();
    let licence = world.path("licence");
    let uses = format!(
        "#include <cstdlib>\n#include <unistd.h>\n__attribute__((constructor)) static void need() \
         {{ if (access(\"{}\", R_OK)) abort(); }}",
        licence.display()
    );
    let Some(plugin) = filter_with(&world, "licensed.so", &uses, &[]) else {
        return skip("the plugin is made with a C++ compiler");
    };
    world.drop_in(&plugin);
    let host = HostProcess::start(&world);
    let (grpc, trocar) = (host.grpcurl(), Trocar::at(&world, host.address()));
    let class = eventually("it is listed", || grpc.classes("host").pop().ok_or("not yet"));
    grpc.refused("GcmService/Create", json!({ "path": "host/f", "class": class }));
    assert!(refused_file(&grpc, "licensed.so").is_ok(), "the list tells what came of it");
    let reload = |what: &str| trocar.run(&["plugin", "reload", what]);
    let early = reload("licensed.so");
    assert!(early.code == 1 && early.stdout.contains("crashes"), "{early:?}");

    fs::write(&licence, "").unwrap();

    let later = reload("licensed.so");
    assert!(later.code == 0 && !later.stdout.contains("crashes"), "{later:?}");
    assert!(refused_file(&grpc, "licensed.so").is_err());
    let unknown = reload("licenced");
    assert!(unknown.code == 1 && unknown.stderr.contains("trocar plugin ls"), "{unknown:?}");
    // The list has no verdict that outlives its reason, good or bad.
    fs::remove_file(&licence).unwrap();
    trocar.run(&["plugin", "reload"]);
    assert!(refused_file(&grpc, "licensed.so").is_ok());
}
