//! The gates A1, A2, A3 and A6 with a tool that comes from the side through the wall of the eye, which holds
//! its shaft.
//!
//! Invariant: bounds and seeds are those of the upright tool; distances are true ones along the tool.

use crate::rig::{NEAREST_M, Rig, Setup, seeds};

#[test]
fn a_tool_from_the_side_keeps_the_offset_as_an_upright_one_does_for_every_seed() {
    for (world, most_rms_m, most_m) in
        [("default", 5.0e-6, 30e-6), ("no_membrane", 3.5e-6, 8e-6), ("static_no_membrane", 0.8e-6, 8e-6)]
    {
        for seed in seeds() {
            let (rms, largest, nearest) = Rig::run(Setup::from_the_side(world, seed)).errors();
            println!("{world} seed {seed}: rms {rms:.3e} largest {largest:.3e} nearest {nearest:.3e}");
            assert!(
                rms <= most_rms_m && largest <= most_m,
                "{world} seed {seed}: rms {rms:.2e} m, largest {largest:.2e} m"
            );
            assert!(nearest > NEAREST_M, "{world} seed {seed}: {nearest:.2e} m");
        }
    }
}

/// A whole breath, s, is 4; and the way away from the retina, with some room.
const BREATH: usize = 4_300;

#[test]
fn control_is_worth_as_much_with_a_tool_from_the_side() {
    let (mut with, mut without) = (0.0, 0.0);
    for seed in seeds() {
        let rig = Rig::run(Setup::from_the_side("default", seed));
        with += rig.errors().0.powi(2);
        without += rig.without_control().powi(2);
    }
    let better = (without / with).sqrt();
    println!("better than without control: {better:.1}");
    assert!(better >= 30.0, "only {better:.1} times better than without control");
}

#[test]
fn after_an_abort_a_lost_surface_or_the_end_a_tool_from_the_side_stays_150_micrometres_away() {
    for seed in seeds() {
        for ending in ["abort", "lost", "end"] {
            // The nearest offset that is possible, more than 200 µm by the lean of 28°; the eye goes up and
            // down by 320 µm.
            let end_m = -1.4e-3 + 20e-6 * seed as f64;
            let mut rig =
                Rig::new(Setup { offset_m: 228e-6, end_m, ..Setup::from_the_side("default", seed) });
            rig.begin();
            rig.until_scanning();
            rig.steps(50 + 37 * seed as usize);
            match ending {
                "abort" => rig.bench.command::<(), ()>("scan/abort", ()).expect("a scan runs"),
                "lost" => rig.dark_until_ns = u64::MAX,
                _ => {}
            }
            rig.until_idle();
            let nearest = rig.watch(BREATH).into_iter().chain([rig.errors().2]).fold(f64::INFINITY, f64::min);
            println!("seed {seed}, {ending}: {nearest:.3e} m at the nearest");
            assert!(nearest > NEAREST_M, "seed {seed}, {ending}: {nearest:.2e} m");
        }
    }
}

#[test]
fn a_tool_that_leans_needs_as_much_more_offset_as_it_leans() {
    let mut rig = Rig::new(Setup { offset_m: 200e-6, ..Setup::from_the_side("static", 1) });
    rig.steps(60);
    let request = crate::ScanRequest { offset: 200e-6, ..Rig::request() };
    let refused = rig.bench.command::<_, ()>("scan/start", request).expect_err("too near");
    assert!(refused.reason.starts_with("offset: 0.0002 is not from 0.00022"), "{}", refused.reason);
}

#[test]
fn the_shaft_stays_in_the_wall_of_the_eye_while_the_tip_scans() {
    let rig = Rig::run(Setup::from_the_side("default", 1));
    let beside_m = rig.beside_port_m.iter().fold(0.0, |most: f64, off| most.max(*off));
    println!("{beside_m:.2e} m beside the port at most");
    assert!((1e-9..20e-6).contains(&beside_m), "{beside_m:.2e} m beside its port");
}
