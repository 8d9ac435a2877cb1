//! Ways in which a required port loses its connection.

/// Way in which a required port lost its connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Loss {
    Cut,
    /// Cut, and announced that another one takes its place next.
    Replaced,
    /// The process of the other end is gone, or does not answer any more.
    Peer,
}

impl Loss {
    /// Time a component may go on without the connection before it counts as lost, ns. A manager that cuts
    /// and connects in two requests has little time; if the second half was announced, that half may also
    /// fail and the former connection be put back before it is a loss.
    pub(crate) fn spared_ns(self) -> u64 {
        match self {
            Loss::Cut => 20_000_000,
            Loss::Replaced => 1_000_000_000,
            Loss::Peer => 0,
        }
    }
}
