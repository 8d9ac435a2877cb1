//! Times a pair of pictures of the eye, 1024 × 768 each: the bare eye, a copy of it, and tool and shadow
//! drawn over it.
//!
//! Invariant: one thread, one scene per round. `picture_bench [ROUNDS]`

use std::time::Instant;

use nalgebra::{Point3, UnitVector3, Vector3};
use trocar_phantom::World;
use trocar_phantom::camera::{Rig, Tool};
use trocar_phantom::render::{Renderer, Scene, Side};

const SIZE: [usize; 2] = [1024, 768];

fn main() {
    let rounds = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(60u64);
    let world = World::named("default", 1).expect("a world's name");
    let mut renderer = Renderer::new(world, Rig::rectified(SIZE[0], SIZE[1]));
    let bytes = 3 * SIZE[0] * SIZE[1];
    let (mut bare, mut done) = (vec![0; 2 * bytes], vec![0; 2 * bytes]);
    let sides = [Side::Left, Side::Right];
    let along = |n: u64| Point3::new(-1.5e-3 + 3e-3 * (n as f64 / rounds as f64), 0.0, -0.5e-3);
    for (name, axis) in [("upright", [0.0, 0.0, 1.0]), ("tilted", [-0.5, 0.1, 1.0])] {
        let axis = UnitVector3::new_normalize(Vector3::from(axis));
        let mut times_ms = [const { Vec::new() }; 3];
        for number in 0..rounds {
            let scene = |tool| Scene { t_s: number as f64 / 30.0, number, tool };
            let (without, with) = (scene(None), scene(Some(Tool::new(along(number), axis))));
            let mut time = |what: usize, work: &mut dyn FnMut()| {
                let begin = Instant::now();
                work();
                times_ms[what].push(begin.elapsed().as_secs_f64() * 1e3);
            };
            time(0, &mut || {
                for (side, to) in sides.into_iter().zip(bare.chunks_exact_mut(bytes)) {
                    renderer
                        .draw(side, &without, |y, row| to[y * row.len()..][..row.len()].copy_from_slice(row));
                }
            });
            time(1, &mut || done.copy_from_slice(std::hint::black_box(&bare)));
            time(2, &mut || {
                for ((side, from), to) in
                    sides.into_iter().zip(bare.chunks_exact(bytes)).zip(done.chunks_exact_mut(bytes))
                {
                    renderer.draw_over(side, &with, from, |y, row| {
                        to[y * row.len()..][..row.len()].copy_from_slice(row);
                    });
                }
            });
        }
        for (what, mut times_ms) in ["bare", "copy", "over"].into_iter().zip(times_ms) {
            times_ms.sort_by(f64::total_cmp);
            let (least, median) = (times_ms[0], times_ms[times_ms.len() / 2]);
            println!(
                r#"{{"tool": "{name}", "what": "{what}", "min_ms": {least:.3}, "median_ms": {median:.3}}}"#
            );
        }
    }
}
