//! The situations a call is made in.
//!
//! Invariant: a situation is about the connection and the server, not about the command; each is played in
//! every way.

use self::Situation::{
    ABusyServer, ABusyServerFromACommand, ACommand, AFullQueue, AStep, AThreadOfItsOwn, BegunAndCut,
    BegunAndHeld, BegunAndPanics, BegunAndRemoved, BegunAndStopped, CutWhileWaiting, FailedWhileWaiting,
    NoConnection, NotActive, OutsideItsLimits, Refusing, RemovedWhileWaiting, StoppedWhileWaiting, Withdrawn,
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Situation {
    /// From a command of the client; nobody is busy.
    ACommand,
    /// From the client's step; nobody is busy.
    AStep,
    /// From a thread that the client has started and waits for.
    AThreadOfItsOwn,
    NoConnection,
    /// The server has been made, or stopped.
    NotActive,
    /// The argument, where there is one, is outside its limits.
    OutsideItsLimits,
    /// The server says no to everything.
    Refusing,
    /// Somebody else is inside the server until long after the deadline.
    ABusyServer,
    /// The same, asked from a command of the client, which must not wait.
    ABusyServerFromACommand,
    /// As often as it takes to fill what is there to be filled, and once more.
    AFullQueue,
    /// It has begun, and does not come back before the deadline.
    BegunAndHeld,
    /// It has begun when its connection is cut, and ends after that.
    BegunAndCut,
    /// It has begun when its server is stopped.
    BegunAndStopped,
    /// It has begun when its server is removed.
    BegunAndRemoved,
    /// It has begun, and panics: its server goes into FAULT in the middle of it.
    BegunAndPanics,
    CutWhileWaiting,
    StoppedWhileWaiting,
    RemovedWhileWaiting,
    FailedWhileWaiting,
    /// The server describes itself without the command, and the connection is not cut yet.
    Withdrawn,
}

// The list below has each of them, in this order.
const _: () = {
    let mut at = 0;
    while at < Situation::ALL.len() {
        assert!(Situation::ALL[at] as usize == at);
        at += 1;
    }
    assert!(at == Withdrawn as usize + 1);
};

impl Situation {
    pub const ALL: [Situation; 20] = [
        ACommand,
        AStep,
        AThreadOfItsOwn,
        NoConnection,
        NotActive,
        OutsideItsLimits,
        Refusing,
        ABusyServer,
        ABusyServerFromACommand,
        AFullQueue,
        BegunAndHeld,
        BegunAndCut,
        BegunAndStopped,
        BegunAndRemoved,
        BegunAndPanics,
        CutWhileWaiting,
        StoppedWhileWaiting,
        RemovedWhileWaiting,
        FailedWhileWaiting,
        Withdrawn,
    ];

    /// The case that plays it.
    #[must_use]
    pub fn case(self) -> &'static str {
        match self {
            ACommand => "of_a_command",
            AStep => "of_a_step",
            AThreadOfItsOwn => "of_a_thread_of_its_own",
            NoConnection => "without_a_connection",
            NotActive => "of_a_server_that_is_not_active",
            OutsideItsLimits => "of_arguments_outside_their_limits",
            Refusing => "of_a_server_that_refuses",
            ABusyServer => "of_a_busy_server",
            ABusyServerFromACommand => "of_a_busy_server_in_a_command",
            AFullQueue => "of_a_full_queue",
            BegunAndHeld => "of_what_was_begun_and_does_not_come_back",
            BegunAndCut => "of_what_was_begun_when_the_connection_is_cut",
            BegunAndStopped => "of_what_was_begun_when_the_server_is_stopped",
            BegunAndRemoved => "of_what_was_begun_when_the_server_is_removed",
            BegunAndPanics => "of_what_was_begun_and_panics",
            CutWhileWaiting => "when_the_connection_is_cut",
            StoppedWhileWaiting => "when_the_server_is_stopped",
            RemovedWhileWaiting => "when_the_server_is_removed",
            FailedWhileWaiting => "when_the_server_fails",
            Withdrawn => "of_commands_that_are_withdrawn",
        }
    }

    /// Something happens to the server while the call waits.
    pub(super) fn ends_a_wait(self) -> bool {
        matches!(self, CutWhileWaiting | StoppedWhileWaiting | RemovedWhileWaiting | FailedWhileWaiting)
    }
}
