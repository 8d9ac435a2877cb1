//! Filters of plain samples, one file each: `low_pass`, `biquad`, `moving_median`, `kalman`, `resampler`,
//! `pid`, `cartesian_transform`, `watchdog`, `add_latency`.
//!
//! Invariant: a sample with a number that nothing can have measured is left out and counted, and the filter
//! goes on with the next one as if it had not come; `add_latency` alone looks at no numbers. `low_pass.rs` is
//! the sample that the documentation shows, a whole plugin; it stays on one screen and is laid out by hand.
#![forbid(unsafe_code)]

// `low_pass.rs` ends with `trocar_plugin!(LowPass)`, as the whole plugin it is. Here it has company: in this
// crate the name `trocar_sdk` is the crate itself, which is the sdk but for what that macro makes of one
// class.
extern crate self as trocar_sdk;
extern crate trocar_sdk as sdk;
#[doc(hidden)]
pub use sdk::*;
#[doc(hidden)]
#[allow(hidden_glob_reexports)] // Which is what it is for.
pub mod prelude {
    pub use sdk::prelude::*;

    pub(crate) use super::plugin_with as trocar_plugin;
}

mod add_latency;
mod biquad;
mod cartesian_transform;
mod good;
mod kalman;
mod lanes;
mod moving_median;
mod pace;
mod pid;
mod resampler;
mod watchdog;

#[rustfmt::skip]
mod low_pass;

/// The plugin of a class and of all others in this crate.
macro_rules! plugin_with {
    ($class:ty) => {
        crate::plugin_of!(
            $class,
            crate::AddLatency,
            crate::Biquad,
            crate::CartesianTransform,
            crate::Kalman,
            crate::MovingMedian,
            crate::Pid,
            crate::Resampler,
            crate::Watchdog
        );
    };
}

/// The plugin of these classes; its tests meet each of them in `of_each`.
macro_rules! plugin_of {
    ($($class:ty),+) => {
        sdk::trocar_plugin!($($class),+);

        #[cfg(test)]
        pub(crate) fn of_each(law: &impl crate::tests::Law) {
            $(law.of::<$class>();)+
        }
    };
}
pub(crate) use plugin_of;
pub(crate) use plugin_with;

pub use add_latency::AddLatency;
pub use biquad::Biquad;
pub use cartesian_transform::CartesianTransform;
pub use kalman::{Estimate, Kalman};
pub use low_pass::Force;
pub use moving_median::MovingMedian;
pub use pid::Pid;
pub use resampler::Resampler;
pub use watchdog::Watchdog;

#[cfg(test)]
mod tests;
