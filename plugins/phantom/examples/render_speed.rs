//! Speed of drawing pictures: `cargo run --release -p trocar-phantom --example render_speed [FILE.png]`.
//!
//! Invariant: one thread; each frame is a whole stereo pair with a moving tool, its shadow and noise.

use std::time::Instant;

use nalgebra::{Point3, UnitVector3, Vector3};
use trocar_phantom::World;
use trocar_phantom::camera::{Rig, Tool};
use trocar_phantom::render::{Renderer, Scene, Side};

const WIDTH: usize = 1024;
const HEIGHT: usize = 768;
const FRAMES: u64 = 300;

fn main() {
    let world = World::named("default", 1).expect("a name of World::NAMES");
    for (name, rig) in
        [("rectified", Rig::rectified(WIDTH, HEIGHT)), ("toed in", Rig::toed_in(WIDTH, HEIGHT))]
    {
        let begun = Instant::now();
        let mut renderer = Renderer::new(world, rig);
        println!("{name}: traced at rest in {:.2} s", begun.elapsed().as_secs_f64());
        let mut pair = vec![0u8; 2 * 3 * WIDTH * HEIGHT];
        let mut each = Vec::new();
        for number in 0..FRAMES {
            let begun = Instant::now();
            frame(&mut renderer, number, &mut pair);
            each.push(begun.elapsed().as_secs_f64() * 1e3);
        }
        each.sort_by(f64::total_cmp);
        let mean = each.iter().sum::<f64>() / each.len() as f64;
        println!(
            "{name}: {WIDTH} × {HEIGHT} × 2: {:.1} pairs/s; ms each: mean {mean:.2}, median {:.2}, p99 {:.2}",
            1e3 / mean,
            each[each.len() / 2],
            each[each.len() * 99 / 100]
        );
        let mut disparity = vec![0; WIDTH * HEIGHT];
        let begun = Instant::now();
        for number in 0..50 {
            renderer.disparity(&scene(number), &mut disparity);
        }
        println!("{name}: disparity {:.2} ms", begun.elapsed().as_secs_f64() * 1e3 / 50.0);
        if let Some(file) = std::env::args().nth(1) {
            frame(&mut renderer, 40, &mut pair);
            let file = format!("{}{file}", if name == "rectified" { "" } else { "toed-in-" });
            image::save_buffer(&file, &pair, WIDTH as u32, 2 * HEIGHT as u32, image::ColorType::Rgb8)
                .expect("the file can be written");
        }
    }
}

fn frame(renderer: &mut Renderer, number: u64, pair: &mut [u8]) {
    let scene = scene(number);
    let (left, right) = pair.split_at_mut(3 * WIDTH * HEIGHT);
    for (side, to) in [(Side::Left, left), (Side::Right, right)] {
        renderer.draw(side, &scene, |y, row| to[y * row.len()..][..row.len()].copy_from_slice(row));
    }
}

fn scene(number: u64) -> Scene {
    let t_s = number as f64 / 60.0;
    let axis = UnitVector3::new_normalize(Vector3::new(-0.7, 0.3 + 0.1 * t_s.sin(), 1.0));
    let tip = Point3::new(1.5e-3 * t_s.sin(), 1e-3 * (1.3 * t_s).cos(), -1.2e-3);
    Scene { t_s, number, tool: Some(Tool::new(tip, axis)) }
}
