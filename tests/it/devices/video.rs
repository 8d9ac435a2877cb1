//! Sources of stereo video: a folder of images, a child process, a camera that is not there.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};
use trocar_tests::{HostProcess, Trocar, World, eventually, repository};

use super::{OK, REFUSED, Site};

/// A grey PNG file whose pixels say which file it is.
fn png(world: &World, name: &str, [width, height]: [u32; 2], level: u8) {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&vec![level; (width * height) as usize]).unwrap();
    writer.finish().unwrap();
    world.write(name, bytes);
}

#[test]
fn pairs_of_a_folder_come_in_the_order_of_their_numbers_and_a_folder_without_pairs_is_refused_by_its_file() {
    let site = Site::with(&["stereo", "display"]);
    for folder in ["pairs", "lonely", "sizes", "broken", "nothing"] {
        fs::create_dir(site.world.path(folder)).unwrap();
    }
    for (number, level) in [("10", 30), ("2", 20), ("1", 10)] {
        for side in ["left", "right"] {
            png(&site.world, &format!("pairs/{side}{number}.png"), [64, 48], level);
        }
    }
    png(&site.world, "lonely/left1.png", [64, 48], 0);
    png(&site.world, "sizes/left1.png", [64, 48], 0);
    png(&site.world, "sizes/right1.png", [48, 64], 0);
    png(&site.world, "broken/left1.png", [64, 48], 0);
    site.world.write("broken/right1.png", "not a picture");
    site.world.write("nothing/readme.txt", "no picture either");
    site.trocar().run(&["create", "host/film", "image_source"]).ends_with(OK).says("CREATED");
    for (folder, words) in [
        ("nowhere", "directory: nowhere: cannot list this folder: No such file"),
        ("lonely", "lonely/left1.png: its partner right1.png is not in the folder"),
        ("sizes", "sizes/right1.png: 48×64 px, but the first left picture is 64×48 px"),
        ("broken", "broken/right1.png: cannot be decoded as PNG or JPEG"),
        ("nothing", "nothing: no left*/right* .png or .jpg files here (1 other entries)"),
    ] {
        site.unfit("host/film", &json!({ "directory": folder }), "COMPONENT_REFUSED", words);
    }
    let deep = json!({ "directory": "pairs", "format": "rgb16" });
    site.unfit("host/film", &deep, "CONFIG_INVALID", r#""rgb16" is none of "as_stored", "rgb8""#);
    // The words it takes are told beforehand, too.
    site.trocar().run(&["describe", "image_source"]).ends_with(OK).says("as_stored | rgb8");

    site.configure("host/film", &json!({ "directory": "pairs" }));
    site.grpc.create_with("host/screen", "display", json!({}), json!({ "stream_of": "host/film" }));
    site.grpc.connect("host/screen/image", "host/film/image");
    site.grpc.start("host/screen");
    site.grpc.start("host/film");
    let shown = site.until("host/screen", "more than all pairs", |row| row["frames"].as_u64() > Some(4));
    assert_eq!((&shown["width"], &shown["height"], &shown["gaps"]), (&json!(64), &json!(48), &json!(0)));
    let frame = site.grpc.ok("InteractService/Read", json!({ "path": "host/film/image" }));
    assert_eq!(
        (&frame["json"]["format"], &frame["frameBytes"]),
        (&json!("GRAY8"), &json!("6144")),
        "{frame}"
    );
    site.grpc.stop("host/film");
    // Real pictures, JPEGs of 640 × 480.
    let chessboards = repository().join("tests/data/chessboard");
    site.configure("host/film", &json!({ "directory": chessboards, "format": "rgb8" }));
    site.grpc.start("host/film");
    site.until("host/screen", "the other size", |row| row["width"] == 640 && row["height"] == 480);
}

/// What a child in a shell does, as the settings of a source of 4 × 2 px of grey.
fn shell(line: &str, more: Value) -> Value {
    let mut config = json!({ "command": ["/bin/sh", "-c", line], "width": 4, "height": 2, "format": "gray8",
                             "restart": true, "restart_delay_s": 0.05, "stall_s": 5 });
    config.as_object_mut().unwrap().extend(more.as_object().cloned().unwrap_or_default());
    config
}

#[test]
fn a_class_that_starts_programs_is_created_only_in_a_process_that_allows_it() {
    let world = World::with_plugins(&["stereo"]);
    let host = HostProcess::start(&world);
    let trocar = Trocar::at(&world, host.address());
    eventually("the class is listed", || match host.grpcurl().plugins().len() {
        0 => Err("no plugin yet"),
        _ => Ok(()),
    });
    trocar.run(&["describe", "stereo/pipe_source"]).ends_with(OK).says("its process does not allow");
    for refused in
        [&["create", "host/pipe", "pipe_source"][..], &["create", "host/pipe", "pipe_source", "--dry-run"]]
    {
        trocar.run(refused).ends_with(REFUSED).says("starts programs").says("--allow-exec");
    }
    let file = |allow: &str| {
        let text = format!(
            r#"{{ "version": 1, "processes": {{ "eye": {{ {allow} }} }},
                 "components": {{ "eye/pipe": {{ "class": "stereo/pipe_source",
                     "config": {{ "command": ["cat", "/dev/zero"], "width": 4, "height": 4 }} }} }} }}"#
        );
        world.write("pipe.json", text).to_string_lossy().into_owned()
    };
    let plugins = world.plugins().to_string_lossy().into_owned();
    let run = |file: String| {
        Trocar::new(&world).run(&[
            "run",
            &file,
            "--plugins",
            &plugins,
            "--listen",
            "127.0.0.1:0",
            "--seconds",
            "0",
        ])
    };
    run(file("")).ends_with(REFUSED).says("starts programs").says("allow_exec");
    run(file(r#""allow_exec": true"#)).ends_with(OK);
}

#[test]
fn a_child_that_writes_dies_stalls_or_is_none_is_told_in_the_operating_state() {
    let mut site = Site::with(&["stereo"]);
    let pids = site.world.path("pids");
    let missing = site.trocar().run(&["create", "host/pipe", "pipe_source"]).ends_with(OK);
    missing.says("CREATED");
    let start = ["start", "host/pipe"];
    site.trocar().run(&start).ends_with(REFUSED).says("command is missing").says("width is missing");
    site.unfit(
        "host/pipe",
        &json!({ "command": [], "width": 4, "height": 2 }),
        "COMPONENT_REFUSED",
        "command: is empty; name a program",
    );
    site.unfit(
        "host/pipe",
        &json!({ "command": "cat", "width": 4, "height": 2 }),
        "CONFIG_INVALID",
        r#"command: "cat" is not an array"#,
    );
    let odd = json!({ "command": ["cat"], "width": 3, "height": 2, "format": "yuyv" });
    site.unfit("host/pipe", &odd, "COMPONENT_REFUSED", "width, height: 3 × 2 px; YUYV wants an even width");
    site.unfit("host/pipe", &shell("", json!({ "width": 0 })), "CONFIG_INVALID", "width: 0 px is below 1 px");

    site.configure("host/pipe", &json!({ "command": ["no-such-program-here"], "width": 4, "height": 2 }));
    site.trocar().run(&start).ends_with(REFUSED).says("no-such-program-here cannot be started: No such file");
    site.grpc.ok("GcmService/Reset", json!({ "path": "host/pipe" }));

    // Each as often as it takes, and what it said last.
    let run = |line: &str, more: Value, said: &str| {
        site.configure("host/pipe", &shell(line, more));
        site.grpc.start("host/pipe");
        let row = site.until("host/pipe", said, |row| {
            let state = &row["operating_state"];
            state["state"] == "FAULT" && state["message"].as_str().is_some_and(|why| why.contains(said))
        });
        assert_eq!(site.grpc.state("host/pipe"), "ACTIVE", "its trouble is the device's");
        site.grpc.stop("host/pipe");
        let state = site.row("host/pipe")["operating_state"]["state"].clone();
        assert_eq!(state, "DISABLED", "{line}");
        row["sent"].clone()
    };
    let once = || json!({ "restart": false });
    let sent = run(
        "echo the lens is broken >&2; exit 3",
        once(),
        "sh ended (exit status: 3) after 0 frames: the lens is broken",
    );
    assert_eq!((&sent["emitted"], &sent["failures"]), (&json!(0), &json!(1)));
    let sent = run("printf 12345678123; exit 0", once(), "after 1 frames and 3 B of the next");
    assert_eq!(sent["emitted"], 1);
    // Run again, since on a busy machine one may not come to write within that time.
    run(
        "printf 1234; exec sleep 1000",
        json!({ "stall_s": 0.2 }),
        "stalled: it wrote 4 B of a frame in 0.2 s after 0 frames; it was ended",
    );
    run("printf 12345678; kill -9 $$", json!({}), "ended (signal: 9 (SIGKILL)) after 1 frames");

    // One that runs, is killed by somebody, and is run again; in the end nothing of it is left.
    let line = format!(
        "sleep 1000 >/dev/null 2>&1 & echo $$ $! >> {}; while printf 12345678; do sleep 0.01; done",
        pids.display()
    );
    site.configure("host/pipe", &shell(&line, json!({})));
    let mut told = site.grpc.stream(
        "InteractService/Subscribe",
        &json!({ "selections": [
        { "path": "host/pipe" }, { "path": "host/pipe/camera/operating_state" } ] }),
    );
    told.until("the state", |item| item["path"] == "host/pipe");
    site.grpc.start("host/pipe");
    let mut next =
        |state: &str| told.until(state, |item| item["json"]["state"] == state)["json"]["message"].clone();
    next("ENABLED");
    site.until("host/pipe", "frames", |row| row["sent"]["emitted"].as_u64() > Some(3));
    let first = fs::read_to_string(&pids).unwrap();
    let child = first.split_whitespace().next().unwrap();
    crate::processes::system::kill("-KILL", child.parse().unwrap());
    let why = next("FAULT");
    assert!(why.as_str().unwrap().contains("signal: 9"), "{why}");
    next("ENABLED");
    assert_eq!(site.row("host/pipe")["sent"]["failures"], 1);
    // The host is killed as a crash would: both go, and what they started.
    site.process.kill();
    eventually("nothing it started is left", || {
        let all = fs::read_to_string(&pids).unwrap();
        let alive: Vec<&str> = all.split_whitespace().filter(|pid| lives(pid)).collect();
        if alive.is_empty() { Ok(()) } else { Err(format!("{alive:?}")) }
    });
}

/// Whether a process is there and has not ended.
fn lives(pid: &str) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit(") ").next().is_some_and(|rest| !rest.is_empty() && !rest.starts_with(['Z', 'X']))
}

#[test]
fn a_camera_that_is_not_there_or_is_none_is_named_with_those_that_are() {
    let site = Site::with(&["stereo"]);
    let there =
        fs::read_dir("/dev").unwrap().flatten().any(|f| f.file_name().to_string_lossy().starts_with("video"));
    let remedy = if there {
        "there is /dev/video"
    } else {
        "there is no /dev/video*: plug a camera in, or use image_source"
    };
    for (device, why) in [
        ("/dev/video987", "cannot be opened: No such file"),
        ("/dev/null", "is no video device"),
        ("/dev", "cannot be opened: Is a directory"),
    ] {
        assert!(device != "/dev/video987" || !Path::new(device).exists());
        site.grpc.create("host/camera", "stereo/camera", json!({ "device": device }));
        let refused = site.trocar().run(&["start", "host/camera"]).ends_with(REFUSED);
        refused.says(&format!("device: {device} {why}")).says(remedy);
        assert_eq!(site.grpc.state("host/camera"), "FAULT");
        site.grpc.ok("GcmService/Remove", json!({ "path": "host/camera" }));
    }
    site.grpc.create("host/camera", "stereo/camera", json!({}));
    let refused = |config: Value, words: &str| site.unfit("host/camera", &config, "CONFIG_INVALID", words);
    refused(json!({ "format": "h264" }), r#""h264" is none of "gray8""#);
    refused(json!({ "width": 20000 }), "width: 20000 px is above 16384 px");
    site.unfit("host/camera", &json!({ "width": 641 }), "COMPONENT_REFUSED", "YUYV wants an even width");
}
