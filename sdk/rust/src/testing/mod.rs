//! A bench for one component in a plain unit test: virtual clock, pushed inputs, recorded outputs, fake
//! peers, no host.
//!
//! Invariant: the bench drives the component through its C table and real slots, so what passes here passes
//! the boundary.
//!
//! ```
//! use trocar_sdk::{prelude::*, testing::Bench};
//!
//! #[derive(Component)]
//! #[component(rate_hz = 100)]
//! struct Double {
//!     #[input]
//!     x: In<f64>,
//!     #[output]
//!     y: Out<f64>,
//!     #[required]
//!     limit: Function<(), f64>,
//! }
//! impl Component for Double {
//!     fn step(&mut self, _: &Tick) -> Result {
//!         let limit = self.limit.call(()).unwrap_or(0.0);
//!         if let Some(x) = self.x.fresh() {
//!             self.y.write(&(2.0 * x).min(limit));
//!         }
//!         Ok(())
//!     }
//! }
//!
//! let mut bench = Bench::<Double>::new("{}");
//! bench.answer("limit", |()| Ok(50.0));
//! bench.push("x", 21.0);
//! bench.step(3);
//! bench.expect_outputs("y", &[42.0]);
//!
//! // Without its peer it gives nothing.
//! bench.fail("limit", Outcome::Deadline);
//! bench.push("x", 21.0);
//! bench.step(1);
//! bench.expect_outputs("y", &[0.0]);
//! ```
//!
//! | to | use |
//! |---|---|
//! | let time pass | `step`, `late_step`, `skip`, `advance`, `now` |
//! | feed inputs | `push`, `push_at`, `push_frame`; `share`, `lose`, `make_stale`, `connect_input` |
//! | see what came out | `outputs`, `samples`, `frames`, `events`, `calls`, `state`; [`numbers`] in them |
//! | expect what comes out | `expect_outputs`, `expect_events`, `expect_calls` |
//! | play the peers | `answer`, `emit`, `command`, `read`; `connect_output`, `connect_function` |
//! | let peers fail | `fail`, `overflow`, `exhaust`, `lose_peer` |
//! | tie untyped ports | `connect_as`, `connect_as_frames`, `connect_as_command`; also `push`, `answer` |
//! | live through a life | `life`, `configure`, `start`, `stop`, `resume`, `make_safe`, `reset` |
//! | survive a swap | `snapshot`, `restore` |
//! | play the system | `answer_service`, `services`, `reply`, `threads`, `refuse_callbacks`, `callbacks` |
//! | read what was logged | `logs`, `expect_log` |
//! | prove | `assert_no_alloc` with [`count_allocations!`], [`assert_implements`] |
//! | prove behaviour | [`assert_behaves_as_arm`], [`assert_behaves_as_camera`] |
//!
//! A failing expectation prints the latest events, with values and times.

mod aligned_bytes;
mod alloc;
mod behaves;
mod bench;
mod callbacks;
mod carried;
mod config;
mod expect;
mod fake_host;
mod fake_system;
mod flows;
mod history;
mod implements;
mod input_cells;
mod limits;
mod logs;
pub(crate) mod manifest;
mod member_cells;
mod numbers;
mod output_cells;
mod parallel;
mod peers;
mod services;
mod shape;
mod time;
mod untyped;
mod wired;

pub use crate::count_allocations;
pub use alloc::CountingAllocator;
pub use behaves::{assert_behaves_as_arm, assert_behaves_as_camera, assert_behaves_as_camera_fed};
pub use bench::{Bench, Failure, Life};
pub use implements::{assert_implements, assert_implements_as};
pub use logs::LogLine;
pub(crate) use logs::keep;
pub use manifest::field_list;
pub use numbers::numbers;
pub use trocar_plugin_api::contracts;
