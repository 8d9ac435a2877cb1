//! Finite numbers in, finite numbers out: of every class, by every execution it is made for.
//!
//! Invariant: the bench does what a host can do: steps late, left out, in the same instant or long after;
//! stamps that repeat, go back, lie ahead or are none; settings that change. The table of classes is
//! `rows.rs`.

use proptest::prelude::*;
use proptest::test_runner::TestRunner;

use trocar_sdk::testing::numbers;

use super::rows::turns;
use super::*;

/// The way a step comes about.
#[derive(Clone, Debug)]
enum Pace {
    /// On the grid, so long after its deadline, ns: periodic, or in the step of another.
    Late(u64),
    /// On the grid, after so many that were left out.
    Behind(u64),
    /// Without a grid, so long after the step before, ns: continuous, on a signal, on a callback, in a
    /// stream.
    After(u64),
}

/// The stamp of a sample.
#[derive(Clone, Debug)]
enum When {
    Now,
    /// That of the sample before.
    Again,
    /// So long before now, ns.
    Back(u64),
    /// So long after now, ns.
    Ahead(u64),
    Never,
}

#[derive(Clone, Debug)]
struct Step {
    pace: Pace,
    samples: Vec<(When, [f64; 6], [f64; 4])>,
    /// Other settings from here on.
    set: Option<String>,
}

/// By the models that a class names; without any, by all.
fn paces<C: Class>() -> BoxedStrategy<Pace> {
    let models = C::DESC.limits.models;
    let names = |some: &[&str]| models.is_empty() || models.iter().any(|model| some.contains(model));
    let ns = || prop_oneof![Just(0u64), (0..13u32).prop_map(|e| 10u64.pow(e)), 0..3_000_000u64];
    let grid = prop_oneof![ns().prop_map(Pace::Late), (0..2000u64).prop_map(Pace::Behind)];
    let free = ns().prop_map(Pace::After);
    match (
        names(&["periodic", "exec_in", "exec_out"]),
        names(&["continuous", "on_signal", "on_callback", "stream"]),
    ) {
        (true, true) => prop_oneof![grid, free].boxed(),
        (true, false) => grid.boxed(),
        _ => free.boxed(),
    }
}

/// Numbers of any size; what a class takes for impossible it leaves out.
fn any_number() -> impl Strategy<Value = f64> {
    let size = prop_oneof![
        4 => ten_to(-3.0, 3.0),
        2 => ten_to(-300.0, 300.0),
        2 => ten_to(97.0, 100.0),
        1 => prop::sample::select(vec![0.0, 1.0, 1e9, 1e100, 1e300, f64::MAX, f64::MIN_POSITIVE, 5e-324]),
    ];
    (size, any::<bool>()).prop_map(|(size, below)| if below { -size } else { size })
}

fn steps<C: Row>() -> impl Strategy<Value = Vec<Step>> {
    let ns = || (0..19u32, 1..10u64).prop_map(|(e, n)| n * 10u64.pow(e));
    let when = prop_oneof![
        6 => Just(When::Now),
        2 => Just(When::Again),
        2 => ns().prop_map(When::Back),
        2 => ns().prop_map(When::Ahead),
        1 => Just(When::Never),
    ];
    let turn = prop_oneof![
        8 => turns(),
        1 => prop::array::uniform4(any_number()),
    ];
    let sample = (when, prop::array::uniform6(any_number()), turn);
    let set = prop_oneof![4 => Just(None), 1 => C::settings().prop_map(Some)];
    let step = (paces::<C>(), prop::collection::vec(sample, 0..4), set);
    prop::collection::vec(step.prop_map(|(pace, samples, set)| Step { pace, samples, set }), 1..12)
}

/// Runs a class; an error names the first number that is none.
fn runs<C: Row>(settings: &str, steps: &[Step]) -> Result<(), TestCaseError> {
    let mut bench = Bench::<C>::new(settings);
    let mut last = bench.now();
    for (n, step) in steps.iter().enumerate() {
        if let Some(settings) = &step.set {
            // A class may refuse what does not suit its samples; the settings before stay.
            let _ = bench.configure(settings);
        }
        for (when, numbers, turn) in &step.samples {
            let now_ns = bench.now().ns();
            let stamp = match when {
                When::Now => bench.now(),
                When::Again => last,
                When::Back(ns) => Stamp::from_ns(now_ns.saturating_sub(*ns)),
                When::Ahead(ns) => Stamp::from_ns(now_ns.saturating_add(*ns)),
                When::Never => Stamp::INVALID,
            };
            last = stamp;
            C::feed(&mut bench, &Given { stamp, numbers: *numbers, turn: *turn });
        }
        let stepped = match step.pace {
            Pace::Late(ns) => bench.late_step(ns),
            Pace::Behind(cycles) => {
                bench.skip(cycles);
                bench.try_step()
            }
            Pace::After(ns) => bench.step_after(ns),
        };
        let told = C::told(&mut bench);
        prop_assert!(told.iter().all(|n| n.is_finite()), "step {n} told {told:?}");
        let row = numbers(&bench.state());
        prop_assert!(row.iter().all(|n| n.is_finite()), "the state of step {n} is {row:?}");
        if let Err(failure) = stepped {
            // In FAULT it tells nothing more; a panic is none of its answers.
            prop_assert!(!failure.panicked(), "step {n}: {failure}");
            break;
        }
    }
    Ok(())
}

#[test]
fn no_class_gives_a_number_that_is_not_finite_by_any_execution() {
    struct Finite;
    impl Law for Finite {
        fn of<C: Row>(&self) {
            let config = ProptestConfig::with_source_file(file!());
            let asked = TestRunner::new(config)
                .run(&(C::settings(), steps::<C>()), |(settings, steps)| runs::<C>(&settings, &steps));
            if let Err(why) = asked {
                panic!("{}: {why}", C::DESC.name);
            }
        }
    }
    crate::low_pass::of_each(&Finite);
}
