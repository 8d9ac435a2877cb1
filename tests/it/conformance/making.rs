//! Tests and tables out of the lists: a module for each way, and in it a test for each case.
//!
//! Invariant: the tests of both suites and the tables that are checked come from the very same lists.

use trocar_tests::conformance::Way;
use trocar_tests::skip;

/// The two suites.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Suite {
    /// The suite `conformance`, which every change has to pass.
    Gate,
    /// The suite `conformance_cross`, which plays everything else.
    Cross,
}

/// The classes of cases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Class {
    /// Code that cannot see how client and server are connected decides about it.
    Independent,
    /// It depends on the way. The two halves have no meaning: neighbours are in different ones, so that each
    /// has cases of every topic, and each is played over a choice of ways of its own.
    First,
    /// The other half.
    Second,
}

/// A case of the list.
pub(crate) struct Case {
    pub(crate) topic: &'static str,
    pub(crate) class: Class,
    pub(crate) name: &'static str,
}

/// A way of the list, and the suite that plays each class of cases in it.
pub(crate) struct Row {
    pub(crate) module: &'static str,
    pub(crate) way: Way,
    independent: Suite,
    first: Suite,
    second: Suite,
}

impl Row {
    pub(crate) fn suite(&self, class: Class) -> Suite {
        match class {
            Class::Independent => self.independent,
            Class::First => self.first,
            Class::Second => self.second,
        }
    }
}

/// Makes the tests of a suite: a module for each way, and in it a test for each case that this suite plays
/// there.
macro_rules! modules {
    (($suite:ident) $($module:ident: $deployment:ident, $client:ident calls $server:ident:
        $independent:ident $first:ident $second:ident;)+) => {
        $(mod $module {
            cases! { tests ($suite ($independent $first $second) ($deployment $client $server)) }
        })+
    };
}

/// Makes the tests of one way.
macro_rules! tests {
    (($suite:ident $plays:tt $way:tt)
        $($from:ident $about:ident { $($class:ident { $($case:ident,)+ })+ })+) => {
        $($(of_class! { $class $plays $suite $way $from $about $($case)+ })+)+
    };
}

/// Finds the suite that plays a class.
macro_rules! of_class {
    (Independent ($independent:ident $first:ident $second:ident) $($rest:tt)+) => {
        in_suite! { $independent $($rest)+ }
    };
    (First ($independent:ident $first:ident $second:ident) $($rest:tt)+) => {
        in_suite! { $first $($rest)+ }
    };
    (Second ($independent:ident $first:ident $second:ident) $($rest:tt)+) => {
        in_suite! { $second $($rest)+ }
    };
}

/// Makes tests where the suite that plays them is the one which is being made.
macro_rules! in_suite {
    (Gate Gate $($rest:tt)+) => { each! { $($rest)+ } };
    (Cross Cross $($rest:tt)+) => { each! { $($rest)+ } };
    (Gate Cross $($rest:tt)+) => {};
    (Cross Gate $($rest:tt)+) => {};
}

macro_rules! each {
    (($deployment:ident $client:ident $server:ident) $from:ident $about:ident $($case:ident)+) => {$(
        #[test]
        fn $case() {
            use trocar_tests::conformance;
            let way = way_of!($deployment $client $server);
            crate::conformance::making::play(way, conformance::$from::$about::$case);
        }
    )+};
}

macro_rules! way_of {
    ($deployment:ident $client:ident $server:ident) => {
        trocar_tests::conformance::Way {
            deployment: &trocar_tests::conformance::$deployment,
            languages: trocar_tests::conformance::Languages {
                client: trocar_tests::conformance::Language::$client,
                server: trocar_tests::conformance::Language::$server,
            },
        }
    };
}

/// Plays a case where its languages can be had.
pub(crate) fn play(way: Way, case: fn(&Way)) {
    if let Some(why) = way.languages.missing() {
        return skip(&why);
    }
    way.play(case);
}

macro_rules! rows {
    (() $($module:ident: $deployment:ident, $client:ident calls $server:ident:
        $independent:ident $first:ident $second:ident;)+) => {
        /// The ways, as values.
        pub(crate) const WAYS: &[Row] = &[$(Row {
            module: stringify!($module),
            way: way_of!($deployment $client $server),
            independent: Suite::$independent,
            first: Suite::$first,
            second: Suite::$second,
        }),+];
    };
}

macro_rules! table {
    (() $($from:ident $about:ident { $($class:ident { $($case:ident,)+ })+ })+) => {
        /// The cases, as values.
        pub(crate) const CASES: &[Case] = &[$($($(Case {
            topic: concat!(stringify!($from), " ", stringify!($about)),
            class: Class::$class,
            name: stringify!($case),
        }),+),+),+];
    };
}

ways! { rows () }
cases! { table () }
