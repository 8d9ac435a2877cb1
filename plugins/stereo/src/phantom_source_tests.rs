//! The simulated source on the bench, with a sensor of few pixels.
#![allow(clippy::unwrap_used)]

use super::*;
use trocar_sdk::data::{Pose, Twist};
use trocar_sdk::testing::{Bench, assert_behaves_as_camera, assert_implements, contracts};

const SMALL: &str = r#""width": 64, "height": 48"#;

fn bench(more: &str) -> Bench<PhantomSource> {
    Bench::new(format!("{{{SMALL}{more}}}"))
}

/// A tip over the apex, pointing down at a slant, moving along x.
fn tip(stamp: Stamp, x: f64, speed_m_s: f64) -> CartesianState {
    CartesianState {
        stamp,
        pose: Pose {
            stamp,
            position: [x, 0.0, -0.5e-3],
            orientation: [0.0, 0.3826834323650898, 0.0, 0.9238795325112867],
        },
        twist: Twist { stamp, linear: [speed_m_s, 0.0, 0.0], ..Twist::default() },
        ..CartesianState::default()
    }
}

fn pair(bench: &mut Bench<PhantomSource>) -> (StereoHeader, Vec<u8>) {
    let (header, bytes, _) = bench.frames::<StereoHeader>("image").pop().unwrap();
    (header, bytes)
}

#[test]
fn a_pair_is_what_the_renderer_draws_at_its_stamp() {
    let mut bench = bench("");
    bench.step(3);
    let (header, bytes) = pair(&mut bench);
    assert_eq!((header.index, header.width, header.height, header.stride), (2, 64, 48, 192));
    assert_eq!(
        (header.stamp, header.format, header.right_offset),
        (bench.now(), PixelFormat::RGB8, 192 * 48)
    );
    let world = World::named("default", 1).unwrap();
    let mut renderer = Renderer::new(world, Rig::rectified(64, 48));
    let scene = Scene { t_s: bench.now().ns() as f64 * 1e-9, number: 2, tool: None };
    let mut drawn = Vec::new();
    for side in [Side::Left, Side::Right] {
        renderer.draw(side, &scene, |_, row| drawn.extend_from_slice(row));
    }
    assert_eq!(bytes, drawn);
    assert!(!bench.state().tool_shown.get());
}

#[test]
fn pairs_drawn_ahead_are_those_of_their_stamp_and_none_is_of_the_future() {
    for (more, format) in [("", PixelFormat::RGB8), (r#", "format": "yuyv""#, PixelFormat::YUYV)] {
        let mut bench = bench(more);
        let renderer = &mut Renderer::new(World::named("default", 1).unwrap(), Rig::rectified(64, 48));
        let mut watchdog = crate::watchdog::Watchdog::of("pairs are drawn ahead");
        // Between two pairs of a camera there is time to draw; here there is as much as this machine needs
        // for it.
        let mut between = std::time::Duration::from_micros(100);
        while bench.state().drawn_ahead < 8 {
            let before = bench.state().drawn_ahead;
            let told = tip(bench.now(), 0.2e-3, 0.003);
            bench.push("tip", told);
            bench.step(1);
            assert!(bench.state().tool_shown.get());
            let (header, bytes) = pair(&mut bench);
            assert!(header.stamp <= bench.now(), "of the future");
            let pose = told.carried(header.stamp).unwrap().isometry;
            let tool = Tool::new(Point3::from(pose.translation.vector), pose.rotation * Vector3::z_axis());
            let scene =
                Scene { t_s: header.stamp.ns() as f64 * 1e-9, number: header.index, tool: Some(tool) };
            let mut drawn = Vec::new();
            for side in [Side::Left, Side::Right] {
                renderer.draw(side, &scene, |y, row| {
                    let at = drawn.len();
                    drawn.resize(at + 64 * format.bytes_per_pixel(), 0);
                    mosaic::write(format, y, row, &mut drawn[at..]);
                });
            }
            assert!(bytes == drawn, "pair {}", header.index);
            watchdog.saw(bench.state().drawn_ahead);
            if bench.state().drawn_ahead == before {
                between = (2 * between).min(std::time::Duration::from_millis(100));
            }
            std::thread::sleep(between);
        }
        // One that no reader has room for does not stop it.
        bench.exhaust("image", true);
        bench.step(2);
        bench.exhaust("image", false);
        bench.step(1);
        assert_eq!((bench.state().left_out, pair(&mut bench).0.index), (2, bench.state().emitted + 1));
    }
}

#[test]
fn a_source_that_was_stopped_goes_on_and_is_configured_anew_in_between() {
    let mut bench = bench("");
    bench.step(2);
    bench.stop().unwrap();
    bench.configure(r#"{"width": 32, "height": 32}"#).unwrap();
    bench.start().unwrap();
    bench.step(3);
    let (header, bytes) = pair(&mut bench);
    assert_eq!((header.index, header.width, bytes.len()), (2, 32, 2 * 3 * 32 * 32));
}

#[test]
fn the_tool_is_carried_on_by_its_velocity_to_the_time_of_the_picture() {
    // 20 ms at 50 mm/s are 1 mm: the moving tool looks like one that stands there.
    let seen = |at: f64, speed: f64, ahead_ms: u64| {
        let mut bench = bench(r#", "world": "static""#);
        let stamp = Stamp::from_ns(bench.now().ns() + 1_000_000_000 / 30 - 1_000_000 * ahead_ms);
        bench.push("tip", tip(stamp, at, speed));
        bench.step(1);
        assert!(bench.state().tool_shown.get());
        pair(&mut bench).1
    };
    let apart = |a: &[u8], b: &[u8]| a.iter().zip(b).filter(|(a, b)| a.abs_diff(**b) > 3).count();
    let there = seen(0.5e-3, 0.0, 20);
    assert!(apart(&seen(-0.5e-3, 0.05, 20), &there) < 20, "carried on");
    assert!(apart(&seen(-0.5e-3, 0.0, 20), &there) > 200, "standing where it was");
}

#[test]
fn a_tip_that_is_no_pose_shows_no_tool() {
    let mut bench = bench("");
    for orientation in [[0.0; 4], [f64::NAN, 0.0, 0.0, 1.0]] {
        let mut bad = tip(bench.now(), 0.0, 0.0);
        bad.pose.orientation = orientation;
        bench.push("tip", bad);
        bench.step(1);
        assert!(!bench.state().tool_shown.get(), "{orientation:?}");
    }
    let mut wild = tip(bench.now(), 0.0, f64::INFINITY);
    wild.pose.position = [1e300, 0.0, 0.0];
    bench.push("tip", wild);
    bench.step(1);
}

#[test]
fn the_formats_are_the_sizes_they_say() {
    for (name, format, bytes) in [
        ("bayer_rg8", PixelFormat::BAYER_RG8, 1),
        ("yuyv", PixelFormat::YUYV, 2),
        ("rgb8", PixelFormat::RGB8, 3),
    ] {
        let mut bench = bench(&format!(r#", "format": "{name}""#));
        bench.step(1);
        let (header, sent) = pair(&mut bench);
        assert_eq!(
            (header.format, header.stride as usize, sent.len()),
            (format, 64 * bytes, 2 * 64 * 48 * bytes)
        );
    }
}

#[test]
fn disparity_is_sent_as_often_as_asked_and_belongs_to_its_pair() {
    let mut bench = bench(r#", "disparity_every": 2"#);
    bench.step(4);
    let told = bench.frames::<ImageHeader>("disparity");
    assert_eq!(told.iter().map(|(h, ..)| h.index).collect::<Vec<_>>(), [0, 2]);
    let (header, bytes, _) = &told[1];
    assert_eq!((header.format, header.stride, bytes.len()), (PixelFormat::GRAY16, 128, 2 * 64 * 48));
    let middle = 2 * (24 * 64 + 32);
    let px = f64::from(u16::from_ne_bytes([bytes[middle], bytes[middle + 1]])) / 256.0;
    // 24 px of 1024 at the apex, and the retina rises beside it.
    assert!((px - 1.5).abs() < 0.1, "{px} px");
}

#[test]
fn the_geometry_leads_from_the_disparity_to_the_distance() {
    let mut bench = bench(r#", "disparity_every": 1, "world": "static""#);
    bench.step(1);
    let told: StereoGeometry = bench.read("stereo_geometry", ()).unwrap();
    let bytes = bench.frames::<ImageHeader>("disparity").remove(0).1;
    let at = 2 * (24 * 64 + 32);
    let disparity = f64::from(u16::from_ne_bytes([bytes[at], bytes[at + 1]])) / 256.0;
    let distance = told.focal_px * told.baseline_m / (disparity + told.offset_px);
    // The pit is 0.1 mm deep; a 256th of a pixel are 25 µm here.
    assert!((distance - 0.2).abs() < 0.3e-3, "{distance} m, {told:?}");
    let toed_in: StereoGeometry =
        Bench::<PhantomSource>::ready(r#"{"width": 64, "height": 48, "rig": "toed_in"}"#)
            .read("stereo_geometry", ())
            .unwrap();
    assert_eq!((toed_in.offset_px, toed_in.centre_left_px), (0.0, [31.5, 23.5]));
    assert_ne!(toed_in.lens, [0.0; 4]);
}

#[test]
fn a_pair_allocates_nothing() {
    let mut bench = bench(r#", "disparity_every": 1"#);
    bench.step(1);
    bench.assert_no_alloc(|bench| {
        bench.push("tip", tip(bench.now(), 0.0, 0.01));
        bench.step(3);
    });
}

#[test]
fn odd_sizes_unknown_worlds_and_a_disparity_that_is_none_are_refused() {
    let refused = |config: &str| Bench::<PhantomSource>::created().configure(config).unwrap_err().reason;
    assert_eq!(refused(r#"{"width": 65}"#), "width, height: 65 × 768 px; both must be even numbers");
    assert!(refused(r#"{"world": "flat"}"#).contains(r#""flat" is not one of"#));
    assert!(refused(r#"{"rig": "toed_in", "disparity_every": 1}"#).contains("set rig to rectified"));
}

#[test]
fn the_worlds_to_choose_from_are_those_there_are() {
    let field = <PhantomSourceConfig as Config>::FIELDS.iter().find(|f| f.name == "world").unwrap();
    let schema = format!("{{{}}}", field.schema);
    let schema: trocar_sdk::serde_json::Value = trocar_sdk::serde_json::from_str(&schema).unwrap();
    assert_eq!(schema["enum"], trocar_sdk::serde_json::json!(World::NAMES));
}

#[test]
fn the_source_fulfils_the_contract_of_cameras_and_behaves_so() {
    assert_implements::<PhantomSource>(&contracts::CAMERA);
    for format in ["rgb8", "yuyv"] {
        assert_behaves_as_camera(&mut bench(&format!(r#", "format": "{format}""#)), "camera");
    }
}
