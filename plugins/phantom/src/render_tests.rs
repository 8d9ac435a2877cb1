//! Pictures of a small sensor: that they are what they should be, pixel by pixel where it matters.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::camera::Rig;
use crate::motion::{Motion, Saccade, Step};
use nalgebra::{Point3, UnitVector3};

const WIDTH: usize = 160;
const HEIGHT: usize = 120;

/// A part of a full sensor, so that pixels have their real size on the retina.
fn part_of(mut rig: Rig, x: f64, y: f64) -> Rig {
    for camera in &mut rig.cameras {
        (camera.width, camera.height) = (WIDTH, HEIGHT);
        camera.centre_px = [camera.centre_px[0] - x, camera.centre_px[1] - y];
    }
    rig
}

fn world(name: &str) -> World {
    World::named(name, 1).unwrap()
}

fn tool(x: f64, y: f64, z: f64) -> Tool {
    Tool::new(Point3::new(x, y, z), UnitVector3::new_normalize(Vector3::new(-0.8, 0.25, 1.0)))
}

fn scene(t_s: f64, tool: Option<Tool>) -> Scene {
    Scene { t_s, number: 5, tool }
}

fn picture(renderer: &mut Renderer, side: Side, scene: &Scene) -> Vec<u8> {
    let mut all = Vec::new();
    renderer.draw(side, scene, |y, row| {
        assert_eq!(all.len(), y * 3 * WIDTH);
        all.extend_from_slice(row);
    });
    all
}

/// The same picture without noise, as levels.
fn silent(mut renderer: Renderer, side: Side, scene: &Scene) -> Vec<u8> {
    again(&mut renderer, side, scene)
}

fn again(renderer: &mut Renderer, side: Side, scene: &Scene) -> Vec<u8> {
    Arc::get_mut(&mut renderer.stage).expect("no twin").noise.fill(PARTS / 2);
    picture(renderer, side, scene)
}

#[test]
fn a_scene_has_one_picture_and_another_number_other_noise() {
    let of = |number| {
        let mut renderer = Renderer::new(world("default"), Rig::rectified(WIDTH, HEIGHT));
        picture(&mut renderer, Side::Left, &Scene { number, ..scene(1.0, Some(tool(0.0, 0.0, -1e-3))) })
    };
    assert_eq!(of(3), of(3));
    assert_ne!(of(3), of(4));
}

#[test]
fn a_tool_drawn_over_the_bare_picture_gives_the_whole_one() {
    let moved = world("default");
    for rig in [Rig::rectified(WIDTH, HEIGHT), part_of(Rig::toed_in(1024, 768), 420.0, 320.0)] {
        let mut renderer = Renderer::new(moved, rig);
        let mut ahead = renderer.twin();
        let tools = [
            None,
            Some(tool(0.0, 0.0, -1e-3)),
            Some(tool(0.3e-3, -0.2e-3, -0.1e-3)),
            Some(tool(9e-3, 9e-3, -1e-3)),
        ];
        for (n, tool) in tools.into_iter().enumerate() {
            for side in [Side::Left, Side::Right] {
                let scene = scene(0.3 * n as f64, tool);
                let bare = picture(&mut ahead, side, &Scene { tool: None, ..scene });
                let mut over = Vec::new();
                renderer.draw_over(side, &scene, &bare, |_, row| over.extend_from_slice(row));
                assert!(over == picture(&mut ahead, side, &scene), "{side:?}, tool {n}");
                assert_eq!(over == bare, n == 0 || n == 3, "{side:?}, tool {n}");
            }
        }
    }
}

#[test]
fn the_noise_has_one_level_standard_deviation() {
    let of = |number| {
        let mut renderer = Renderer::new(world("static"), Rig::rectified(WIDTH, HEIGHT));
        picture(&mut renderer, Side::Left, &Scene { number, ..scene(0.0, None) })
    };
    let (one, other) = (of(1), of(2));
    let mut sums = [0.0; 3];
    for (a, b) in one.iter().zip(&other).filter(|(a, _)| (20..235).contains(*a)) {
        let d = f64::from(*a) - f64::from(*b);
        sums = [sums[0] + 1.0, sums[1] + d, sums[2] + d * d];
    }
    assert!(sums[0] > 20_000.0, "{} values in the middle of the range", sums[0]);
    // Two pictures differ by twice the variance of one, and rounding adds a twelfth to each.
    let variance = sums[2] / sums[0] / 2.0 - 1.0 / 12.0;
    assert!((variance - 1.0).abs() < 0.05 && (sums[1] / sums[0]).abs() < 0.05, "{variance}");
}

#[test]
fn an_eye_that_moved_looks_as_if_it_had_been_traced_there() {
    let motions = [
        Motion { step: Some(Step { at_s: 0.0, by_m: 160e-6 }), ..Motion::none() },
        Motion { saccade: Some(Saccade { at_s: 0.0, by_m: 0.3e-3, speed_m_s: 1.0 }), ..Motion::none() },
    ];
    for motion in motions {
        let moves = World { motion, ..world("static") };
        for rig in [Rig::rectified(1024, 768), Rig::toed_in(1024, 768)] {
            let rig = part_of(rig, 700.0, 500.0);
            // The same cameras, moved the other way, see the eye at rest as the moving one is seen.
            let mut against = rig;
            for camera in &mut against.cameras {
                camera.world_from_camera.translation.vector -= motion.shift(1.0);
            }
            let shown = silent(Renderer::new(moves, rig), Side::Right, &scene(1.0, None));
            let traced = silent(Renderer::new(world("static"), against), Side::Right, &scene(1.0, None));
            let apart = |a: &[u8], b: &[u8]| {
                a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64
            };
            let off = apart(&shown, &traced);
            assert!(off < 1.5, "{off} levels on average, {motion:?}");
            if motion.saccade.is_some() {
                let still = silent(Renderer::new(world("static"), rig), Side::Right, &scene(1.0, None));
                assert!(apart(&still, &traced) > 2.0 * off, "{off}, and it hardly moved");
            }
        }
    }
}

#[test]
fn the_tool_is_where_the_camera_sees_its_tip() {
    let rig = Rig::toed_in(WIDTH, HEIGHT);
    let tool = tool(0.4e-3, 0.2e-3, -1e-3);
    let mut renderer = Renderer::new(world("static"), rig);
    for (side, camera) in [(Side::Left, rig.cameras[0]), (Side::Right, rig.cameras[1])] {
        let bare = again(&mut renderer, side, &scene(0.0, None));
        let with = again(&mut renderer, side, &scene(0.0, Some(tool)));
        let at = |point: Point3<f64>| {
            let ([u, v], _) = camera.project(&point).unwrap();
            3 * (v.round() as usize * WIDTH + u.round() as usize)
        };
        let shaft = at(tool.core()[0] - tool.axis.as_ref() * 1e-3);
        let changed = |at: usize| bare[at..at + 3].iter().zip(&with[at..at + 3]).any(|(a, b)| a != b);
        assert!(changed(shaft), "the shaft is drawn");
        let before = at(tool.tip + tool.axis.as_ref() * 0.5e-3);
        assert!(!with[before..before + 3].iter().zip(&with[shaft..shaft + 3]).all(|(a, b)| a == b));
        // Steel is grey, the retina is red.
        assert!(with[shaft].abs_diff(with[shaft + 2]) < 40, "{:?}", &with[shaft..shaft + 3]);
    }
}

#[test]
fn the_spans_leave_out_no_pixel_of_tool_and_shadow() {
    let mut renderer = Renderer::new(world("static"), Rig::toed_in(WIDTH, HEIGHT));
    for n in 0..12 {
        let f = f64::from(n);
        let tool =
            tool(2e-3 * (f * 1.7).sin(), 1.5e-3 * (f * 0.9).cos(), -3e-3 * (f * 0.37).sin().abs() - 0.1e-3);
        let scene = scene(0.0, Some(tool));
        let small = again(&mut renderer, Side::Left, &scene);
        // The same, looking at every pixel.
        let Renderer { stage, work } = &mut renderer;
        let Stage { eyes, lamp, field, noise, .. } = &**stage;
        let (eye, shift) = (&eyes[0], Vector3::zeros());
        let warp = eye.warp(&shift);
        work.follow(&warp, WIDTH);
        for spans in [&mut work.tool, &mut work.shadow] {
            spans.rows.fill((0, WIDTH as u32));
        }
        let scenery = Scenery { eye, lamp, tool: &tool, core: tool.core(), warp, shift };
        work.shade.begin(&scenery);
        let mut all = Vec::new();
        for y in 0..HEIGHT {
            work.retina(eye, &warp, y, 0..WIDTH);
            work.darken(&scenery, y);
            work.paint(&scenery, y, 0..WIDTH);
            work.finish(field, noise, world("static").noise(NOISE_STREAM), y, 0..WIDTH);
            all.extend_from_slice(&work.bytes);
        }
        let missed = small.iter().zip(&all).filter(|(a, b)| a.abs_diff(**b) > 2).count();
        // Shadows from beyond the field may end at its border.
        assert!(missed < WIDTH * HEIGHT * 3 / 200, "{missed} values of tool {n} are missing");
    }
}

#[test]
fn disparity_leads_from_the_left_pixel_to_the_same_point_in_the_right_picture() {
    let rig = Rig::rectified(WIDTH, HEIGHT);
    let tool = tool(0.3e-3, 0.1e-3, -2e-3);
    let mut renderer = Renderer::new(world("default"), rig);
    let scene = scene(0.7, Some(tool));
    let mut told = vec![7; WIDTH * HEIGHT];
    renderer.disparity(&scene, &mut told);
    let world = world("default");
    let shift = world.motion.shift(0.7);
    let [left, right] = rig.cameras;
    let (mut seen, mut on_tool) = (0, 0);
    for (n, units) in told.iter().enumerate().filter(|(_, units)| **units > 0) {
        let (x, y) = ((n % WIDTH) as f64, (n / WIDTH) as f64);
        // Traced on its own, without the picture at rest.
        let way = (left.point(left.ray([x, y]), 1.0) - left.eye()).normalize();
        let mut far = 0.2;
        for _ in 0..20 {
            let at = left.eye() + way * far;
            far += (world.eye.surface_z(at.x - shift.x, at.y - shift.y) + shift.z - at.z) / way.z;
        }
        if let Some(near) = tool.meet(&left.eye(), &way) {
            far = near;
            on_tool += 1;
        }
        let ([u, v], _) = right.project(&(left.eye() + way * far)).unwrap();
        let disparity = f64::from(*units) / DISPARITY_UNITS_PER_PX;
        assert!((x - disparity - u).abs() < 0.01 && (v - y).abs() < 1e-6, "{disparity} px at {x}, {y}: {u}");
        seen += 1;
    }
    let ([middle_x, middle_y], radius) = rig.field_px();
    let away = |n: usize| (((n % WIDTH) as f64 - middle_x).hypot((n / WIDTH) as f64 - middle_y)) / radius;
    let inside = (0..told.len()).filter(|n| away(*n) < 1.0).count();
    assert!(seen > inside * 9 / 10 && seen < inside, "{seen} of {inside} pixels are seen by both eyes");
    assert!((0..told.len()).all(|n| away(n) < 1.0 || told[n] == 0), "nothing is seen outside of the field");
    assert!(on_tool > 50, "{on_tool} of them show the tool");
}

#[test]
fn the_right_picture_shows_at_its_disparity_what_the_left_one_shows() {
    let rig = part_of(Rig::rectified(1024, 768), 300.0, 200.0);
    let scene = scene(0.4, None);
    let mut told = vec![0; WIDTH * HEIGHT];
    Renderer::new(world("static"), rig).disparity(&scene, &mut told);
    let mut renderer = Renderer::new(world("static"), rig);
    let [left, right] = [Side::Left, Side::Right].map(|side| again(&mut renderer, side, &scene));
    let green = |picture: &[u8], x: usize, y: usize| f64::from(picture[3 * (y * WIDTH + x) + 1]);
    let (mut at_place, mut beside, mut count) = (0.0, 0.0, 0.0);
    for y in 0..HEIGHT {
        for x in 40..WIDTH - 20 {
            let column = x as f64 - f64::from(told[y * WIDTH + x]) / DISPARITY_UNITS_PER_PX;
            let (whole, part) = (column as usize, column.fract());
            let there = |ahead: usize| {
                green(&right, whole + ahead, y) * (1.0 - part) + green(&right, whole + ahead + 1, y) * part
            };
            at_place += (green(&left, x, y) - there(0)).abs();
            beside += (green(&left, x, y) - there(4)).abs();
            count += 1.0;
        }
    }
    assert!(at_place < 0.5 * beside && at_place / count < 3.0, "{at_place} and {beside} of {count}");
}

#[test]
fn a_rig_that_is_not_rectified_has_no_disparity() {
    let mut told = vec![7; WIDTH * HEIGHT];
    Renderer::new(world("static"), Rig::toed_in(WIDTH, HEIGHT)).disparity(&scene(0.0, None), &mut told);
    assert!(told.iter().all(|units| *units == 0));
}

#[test]
fn a_tool_behind_the_cameras_or_beside_the_field_draws_nothing_and_harms_nothing() {
    let mut renderer = Renderer::new(world("static"), Rig::rectified(WIDTH, HEIGHT));
    let bare = again(&mut renderer, Side::Left, &scene(0.0, None));
    for at in [Point3::new(0.0, 0.0, -0.5), Point3::new(0.2, 0.0, -1e-3), Point3::new(0.0, -0.3, 0.2)] {
        let tool = Tool::new(at, Vector3::z_axis());
        assert_eq!(again(&mut renderer, Side::Left, &scene(0.0, Some(tool))), bare);
    }
    let nowhere = Tool::new(Point3::new(f64::NAN, 0.0, f64::INFINITY), Vector3::z_axis());
    again(&mut renderer, Side::Left, &scene(0.0, Some(nowhere)));
}

#[test]
fn the_round_field_is_the_same_in_both_images_and_stands_still_while_the_eye_moves() {
    let motion =
        Motion { saccade: Some(Saccade { at_s: 1.0, by_m: 0.3e-3, speed_m_s: 1.0 }), ..Motion::none() };
    for rig in [Rig::rectified(WIDTH, HEIGHT), Rig::toed_in(WIDTH, HEIGHT)] {
        let mut renderer = Renderer::new(World { motion, ..world("static") }, rig);
        let ([middle_x, middle_y], radius) = rig.field_px();
        let mut pictures = Vec::new();
        for t_s in [0.0, 2.0] {
            for side in [Side::Left, Side::Right] {
                pictures.push(again(&mut renderer, side, &scene(t_s, Some(tool(0.2e-3, 0.1e-3, -1e-3)))));
            }
        }
        assert!(pictures[0] != pictures[2], "the eye moved");
        for n in 0..WIDTH * HEIGHT {
            let away = ((n % WIDTH) as f64 - middle_x).hypot((n / WIDTH) as f64 - middle_y);
            for picture in &pictures {
                let red = picture[3 * n];
                assert!(away < radius + 1.0 || red < 5, "{red} at {n} outside of the field");
                assert!(away > radius - 2.0 || red > 5, "{red} at {n} inside of the field");
            }
        }
    }
}
