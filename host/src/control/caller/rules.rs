//! Rules of a port: what its callers may do.

/// Rights of callers at a port, beyond everybody's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PortRules {
    pub viewer: Viewer,
    /// Every caller that reaches the port may do everything, other users of the machine, too.
    pub open_loopback: bool,
}

/// Rights of the viewer's page on a port.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Viewer {
    /// Everything that any caller of the port may do.
    #[default]
    Full,
    /// Look only: requests through a browser change nothing. Programs that speak gRPC are not affected.
    ReadOnly,
}
