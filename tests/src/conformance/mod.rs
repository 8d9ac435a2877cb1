//! The conformance suite: what connected components may rely on, the same for every way to connect them and
//! every language.
//!
//! Invariant: a case knows neither where its components run nor what they are written in; what may differ it
//! asks its [`Way`]. No case is left out for one of them.

mod answer;
pub mod cases;
pub mod choice;
mod language;
mod looking;
pub mod matrix;
mod parted;
mod parts;
pub mod random;
mod typed;
mod waiting;
mod way;
mod world;

pub use answer::{Answer, Call, Function, Samples};
pub use language::{Language, Languages};
pub use parted::{
    BuiltProcesses, OtherMachine, OtherProcess, OtherProcessOfCalledBack, OtherProcessOfFreeClient,
    OtherProcessOfFreeServer, OtherProcessOfPassive, OtherProcessOnGrids, OtherProcessOnTurnedGrids,
};
pub use way::{
    Deployment, ExecIn, ExecOut, OtherThread, Passive, Reach, SameStream, SharedMemory, Told, Way,
};
pub use world::Lab;
