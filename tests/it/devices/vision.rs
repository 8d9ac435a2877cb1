//! Vision filters, depth on a branch, and the picture of the display, as one system file that is up.

use std::io::Read;

use serde_json::{Value, json};
use trocar_tests::repository;

use super::{OK, REFUSED, head, picture, request};
use crate::processes::system::System;

const PLUGINS: [&str; 4] = ["stereo", "vision_filters", "stereo_depth", "display"];

fn data(file: &str) -> String {
    repository().join("tests/data").join(file).display().to_string()
}

/// A colour camera with a Bayer filter to the screen, a YUYV one as inset and to depth, real pairs to be
/// rectified.
fn file() -> String {
    let source = |format: &str| {
        json!({ "class": "stereo/phantom_source", "execution": { "model": "stream", "rate_hz": 30 },
                                        "config": { "format": format, "width": 320, "height": 240 } })
    };
    let behind = |source: &str, class: &str, config: Value| json!({ "class": class, "execution": { "stream_of": source }, "config": config });
    let filter =
        |source: &str, class: &str, config: Value| behind(source, &format!("vision-filters/{class}"), config);
    let depth = |config: Value| json!({ "class": "stereo-depth/stereo_depth", "config": config });
    let connections = [
        ("debayer/image", "bayer/image"),
        ("flip/image", "debayer/color"),
        ("overlay/image", "flip/flipped"),
        ("pip/image", "overlay/overlaid"),
        ("pip/inset", "crop/part"),
        ("screen/image", "pip/composed"),
        ("color/image", "yuyv/image"),
        ("crop/image", "color/converted"),
        ("gray/image", "color/converted"),
        ("bm/rectified", "gray/gray"),
        ("sgm/rectified", "color/converted"),
        ("rectify/image", "pairs/image"),
    ];
    let connections: Vec<Value> = connections
        .iter()
        .map(|(client, server)| json!({ "client": format!("host/{client}"), "server": format!("host/{server}") }))
        .collect();
    json!({
        "version": 1,
        "processes": { "host": {} },
        "components": {
            "host/bayer":   source("bayer_rg8"),
            "host/debayer": filter("host/bayer", "debayer", json!({})),
            "host/flip":    filter("host/bayer", "flip", json!({ "direction": "both" })),
            "host/overlay": filter("host/bayer", "overlay", json!({})),
            "host/pip":     filter("host/bayer", "pip", json!({ "w": 80, "h": 60 })),
            "host/screen":  behind("host/bayer", "display/display", json!({})),
            "host/yuyv":    source("yuyv"),
            "host/color":   filter("host/yuyv", "color", json!({})),
            "host/crop":    filter("host/yuyv", "crop", json!({ "x": 40, "y": 30, "width": 240, "height": 180 })),
            "host/gray":    filter("host/yuyv", "gray", json!({})),
            "host/bm":      depth(json!({ "method": "bm", "width": 320, "height": 240,
                                          "focal_px": 6400, "baseline_m": 0.005, "offset_px": 152.5 })),
            "host/sgm":     depth(json!({ "method": "sgm", "width": 320, "height": 240 })),
            "host/pairs":   { "class": "stereo/image_source", "execution": { "model": "stream", "rate_hz": 10 },
                              "config": { "directory": data("chessboard") } },
            "host/rectify": filter("host/pairs", "rectify", json!({ "calibration": data("calibration/chessboard.json") })),
        },
        "connections": connections,
    })
    .to_string()
}

/// The newest row of a component's state table, as soon as it is as wanted.
fn until(system: &System, component: &str, what: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    trocar_tests::eventually(&format!("{component}: {what}"), || {
        let row = system.grpc.ok("InteractService/Read", json!({ "path": component }))["json"].clone();
        if wanted(&row) { Ok(row) } else { Err(row.to_string()) }
    })
}

#[test]
fn every_filter_of_one_system_file_passes_each_frame_and_a_browser_sees_the_result() {
    let system = System::up_with(&PLUGINS, &file(), &[]);
    for filter in ["debayer", "flip", "overlay", "pip", "color", "crop", "gray", "rectify"] {
        let row = until(&system, &format!("host/{filter}"), "frames", |row| {
            row["tally"]["frames"].as_u64() > Some(2)
        });
        assert_eq!(row["tally"]["rejected"], 0, "{filter}: {row}");
    }
    let inset = until(&system, "host/pip", "an inset", |row| row["inset_shown"] == true);
    assert_eq!(inset["insets"]["rejected"], 0, "{inset}");
    // Depth of the phantom's retina, 200 mm away, by both matchers.
    let depth_at = |component: &str, u: u32| {
        let at = json!({ "u": u, "v": 120 }).to_string();
        system.trocar().run(&["call", &format!("{component}/map/depth_at"), &at, "--json"])
    };
    for matcher in ["host/bm", "host/sgm"] {
        let row = until(&system, matcher, "a map", |row| row["frames"].as_u64() > Some(1));
        assert!(row["density"].as_f64() > Some(0.5) && row["rejected"] == 0, "{matcher}: {row}");
    }
    let depth = depth_at("host/bm", 160).ends_with(OK).json()["value"].clone();
    assert!((depth["distance"].as_f64().unwrap() - 0.2).abs() < 0.005, "{depth}");
    depth_at("host/bm", 1600).ends_with(REFUSED).says("outside of the image: u is 0 to 319, v 0 to 239");
    depth_at("host/sgm", 160).ends_with(REFUSED).says("configure calibration, or focal_px and baseline_m");

    // Without a path: what goes into the display.
    let mut stream = request(system.process.address(), "/video.mjpeg?width=320");
    let (status, headers) = head(&mut stream);
    assert!(status.contains("200"), "{status}");
    assert!(headers.iter().any(|h| h.starts_with("content-type: multipart/x-mixed-replace")), "{headers:?}");
    let mut shown = |what: &str, wanted: &dyn Fn(&[u8]) -> bool| {
        // At 30 pictures a second: the watchdog of a minute.
        let found = (0..1800).map(|_| pixels(&picture(&mut stream))).find(|pixels| wanted(pixels));
        found.unwrap_or_else(|| panic!("not seen by a browser: {what}"))
    };
    shown("the retina", &|pixels| pixels.chunks(3).filter(|p| p[0] > 60).count() > 10_000);
    // A filled square of green, and the inset out of its way.
    let call = |path: &str, arg: Value| system.trocar().run(&["call", path, &arg.to_string()]);
    call("host/pip/inset_control/set_visible", json!(false)).ends_with(OK);
    let line = json!({ "item": 2, "from": [140, 120], "to": [180, 120], "width": 40, "color": [0, 255, 0, 255],
                       "eye": "LEFT", "disparity": 0 });
    call("host/overlay/items/set_line", line).ends_with(OK);
    let green = |pixels: &[u8]| {
        let p = &pixels[3 * (120 * 320 + 160)..];
        p[0] < 60 && p[1] > 200 && p[2] < 60
    };
    shown("the line", &green);
    call("host/overlay/items/clear", Value::Null).ends_with(OK);
    shown("it is gone", &|pixels| !green(pixels));

    // A place that is none, and a source that stands still.
    let (status, _) = head(&mut request(system.process.address(), "/video.mjpeg?path=host/nobody/image"));
    assert!(status.contains("404"), "{status}");
    system.grpc.stop("host/bayer");
    let mut rest = Vec::new();
    stream.read_to_end(&mut rest).unwrap();
    assert!(rest.ends_with(b"--trocar-frame\r\n"), "it ends behind a whole picture");
}

/// Pixels of a JPEG of 320 × 240, red, green, blue.
fn pixels(jpeg: &[u8]) -> Vec<u8> {
    let image = image::load_from_memory_with_format(jpeg, image::ImageFormat::Jpeg)
        .expect("a JPEG that can be decoded");
    assert_eq!((image.width(), image.height()), (320, 240));
    image.into_rgb8().into_raw()
}

#[test]
fn what_a_filter_cannot_do_is_refused_by_name_or_told_in_its_state() {
    let system = System::up_with(&PLUGINS, &file(), &[]);
    let grpc = &system.grpc;
    // Items and insets, by commands.
    for (member, arg, reason, words) in [
        (
            "overlay/items/set_text",
            json!({ "text": "500 µm", "item": 40, "x": 0, "y": 0, "size": 24, "color": [255, 0, 0, 255],
                                           "eye": "BOTH", "disparity": 0 }),
            "COMMAND_FAILED",
            "item 40 is above 31",
        ),
        (
            "overlay/items/set_line",
            json!({ "item": 2, "from": [0, 0], "to": [9, 9], "width": 200, "color": [255, 0, 0, 255],
                                           "eye": "BOTH", "disparity": 0 }),
            "COMMAND_FAILED",
            "a width of 200 px is not 1 to 64 px",
        ),
        (
            "overlay/items/set_picture",
            json!({ "item": 3, "picture": 0, "x": 0, "y": 0, "alpha": 255, "eye": "BOTH", "disparity": 0 }),
            "COMMAND_FAILED",
            "there is no picture 0: 0 are configured",
        ),
        ("overlay/items/remove", json!(50), "ARGUMENT_INVALID", "item 50 is above maximum 31"),
        (
            "pip/inset_control/set_rect",
            json!({ "x": 0, "y": 0, "w": 60, "h": 40, "alpha": 5 }),
            "COMMAND_FAILED",
            "an alpha of 5 is not 0 to 1",
        ),
        (
            "pip/inset_control/set_rect",
            json!({ "x": 0, "y": 0, "w": 9999, "h": 40, "alpha": 1 }),
            "COMMAND_FAILED",
            "larger than max_width × max_height",
        ),
    ] {
        let body = json!({ "path": format!("host/{member}"), "json": arg });
        let refused = grpc.refused_when_heard("InteractService/Invoke", &body);
        assert!(refused.reason == reason && refused.message.contains(words), "{refused}");
    }
    // Settings while frames flow.
    let unfit = |component: &str, config: Value, reason: &str, words: &str| {
        let body = json!({ "path": component, "config": config });
        let refused = grpc.refused_when_heard("GcmService/Configure", &body);
        assert!(refused.reason == reason && refused.message.contains(words), "{config}: {refused}");
    };
    unfit(
        "host/bm",
        json!({ "n_disp": 97 }),
        "COMPONENT_REFUSED",
        "n_disp: 97 is not a multiple of 32 from 32 to 256 px: take 128",
    );
    unfit(
        "host/bm",
        json!({ "block": 8 }),
        "COMPONENT_REFUSED",
        "block: 8 px is not an odd number from 5 to 31",
    );
    unfit("host/bm", json!({ "method": "orb" }), "CONFIG_INVALID", r#""orb" is none of "bm", "sgm""#);
    unfit(
        "host/sgm",
        json!({ "p1": 50, "p2": 40 }),
        "COMPONENT_REFUSED",
        "p1: 50 and p2: 40 are not 1 ≤ p1 ≤ p2 ≤ 103",
    );
    grpc.ok("GcmService/Configure", json!({ "path": "host/crop", "config": { "x": 300 } }));
    let row = until(&system, "host/crop", "left out", |row| row["tally"]["rejected"].as_u64() > Some(0));
    assert!(row["tally"]["problem"].as_str().unwrap().contains("configure a part that lies in it"), "{row}");

    // Calibrations that cannot rectify.
    grpc.stop("host/rectify");
    let good: Value =
        serde_json::from_str(&std::fs::read_to_string(data("calibration/chessboard.json")).unwrap()).unwrap();
    let changed = |pointer: &str, value: Value| {
        let mut other = good.clone();
        *other.pointer_mut(pointer).unwrap() = value;
        other.to_string()
    };
    let mut without = good.clone();
    without["left"].as_object_mut().unwrap().remove("distortion");
    for (name, text, words) in [
        (
            "singular",
            changed("/left/matrix", json!([[0, 0, 0], [0, 0, 0], [0, 0, 0]])),
            "left.matrix: focal lengths 0 and 0 px are not both at least 0.001 px: it is singular",
        ),
        (
            "mirrored",
            changed("/right/rectification", json!([[1, 0, 0], [0, 1, 0], [0, 0, -1]])),
            "right.rectification: it is no rotation",
        ),
        (
            "one_place",
            changed("/right/projection/0/3", json!(0.0)),
            "the cameras stand in one place, or left and right are swapped",
        ),
        ("newer", changed("/version", json!(9)), "version 9, not \"trocar-stereo-calibration\" version 1"),
        (
            "empty",
            changed("/image_size", json!([0, 480])),
            "image_size: 0 × 480 px is outside of 1 to 16384 px a side",
        ),
        ("incomplete", without.to_string(), "missing field `distortion`"),
        ("torn", good.to_string()[..100].to_owned(), "no calibration: EOF while parsing"),
    ] {
        let path = system.world.write(&format!("{name}.json"), text);
        let shown = path.display().to_string();
        unfit(
            "host/rectify",
            json!({ "calibration": path }),
            "COMPONENT_REFUSED",
            &format!("calibration: {shown}: "),
        );
        unfit("host/rectify", json!({ "calibration": path }), "COMPONENT_REFUSED", words);
    }
    unfit(
        "host/rectify",
        json!({ "calibration": "nowhere.json" }),
        "COMPONENT_REFUSED",
        "nowhere.json: cannot be read: No such file",
    );
    // The one it had still holds; one for images of another size is told when they come.
    grpc.start("host/rectify");
    until(&system, "host/rectify", "frames again", |row| row["tally"]["frames"].as_u64() > Some(1));
    grpc.stop("host/rectify");
    let other = system.world.write("other.json", changed("/image_size", json!([320, 240])));
    grpc.ok("GcmService/Configure", json!({ "path": "host/rectify", "config": { "calibration": other } }));
    grpc.start("host/rectify");
    let row = until(&system, "host/rectify", "left out", |row| row["tally"]["rejected"].as_u64() > Some(0));
    assert!(row["tally"]["problem"].as_str().unwrap().contains("calibrate at this size"), "{row}");
    // Raw pixels of a colour filter are no picture for a display or a matcher.
    grpc.ok(
        "GcmService/Disconnect",
        json!({ "client": "host/sgm/rectified", "server": "host/color/converted" }),
    );
    grpc.connect("host/sgm/rectified", "host/bayer/image");
    let row = until(&system, "host/sgm", "left out", |row| row["rejected"].as_u64() > Some(0));
    assert!(!row["problem"].as_str().unwrap().is_empty(), "{row}");
}
