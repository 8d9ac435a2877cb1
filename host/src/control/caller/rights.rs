//! A table of the methods of a port: what each does, and which certificates let their holders ask them. One
//! row for each method.
//!
//! Invariant: a method without a row is nobody's but a GCM's, so a new one is refused until it has one.

use trocar_model::{ComponentId, Refusal};
use trocar_net::{Holder, Role};

use super::Peer;

/// The kind of a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Right {
    /// Changes nothing. `Invoke` and `WaitFor` look at the command that is called: see `OnlyReads`.
    Reads,
    /// Runs what is there.
    Operates,
    /// Changes what is there.
    Administers,
    /// Tells and hears what only a process of the system does.
    Attaches,
    /// Asks who leads. Where it tells of processes, it is looked at who tells.
    Tells,
}

/// All methods there are.
const METHODS: [(&str, Right); 49] = [
    ("/trocar.v1.AgentService/Bring", Right::Administers),
    ("/trocar.v1.AgentService/Keep", Right::Administers),
    ("/trocar.v1.AgentService/ListSystems", Right::Reads),
    ("/trocar.v1.AgentService/Missing", Right::Administers),
    ("/trocar.v1.AttachService/Attach", Right::Attaches),
    ("/trocar.v1.AttachService/Feed", Right::Attaches),
    ("/trocar.v1.AttachService/Supervise", Right::Attaches),
    ("/trocar.v1.AttachService/Tell", Right::Tells),
    ("/trocar.v1.GcmService/Apply", Right::Administers),
    ("/trocar.v1.GcmService/Compare", Right::Reads),
    ("/trocar.v1.GcmService/Configure", Right::Operates),
    ("/trocar.v1.GcmService/Connect", Right::Administers),
    ("/trocar.v1.GcmService/Create", Right::Administers),
    ("/trocar.v1.GcmService/Describe", Right::Reads),
    ("/trocar.v1.GcmService/Disconnect", Right::Administers),
    ("/trocar.v1.GcmService/Forget", Right::Administers),
    ("/trocar.v1.GcmService/GetState", Right::Reads),
    ("/trocar.v1.GcmService/List", Right::Reads),
    ("/trocar.v1.GcmService/Move", Right::Administers),
    ("/trocar.v1.GcmService/Remove", Right::Administers),
    ("/trocar.v1.GcmService/Replace", Right::Administers),
    ("/trocar.v1.GcmService/Reset", Right::Operates),
    ("/trocar.v1.GcmService/Restart", Right::Administers),
    ("/trocar.v1.GcmService/Resume", Right::Operates),
    ("/trocar.v1.GcmService/Save", Right::Reads),
    ("/trocar.v1.GcmService/Start", Right::Operates),
    ("/trocar.v1.GcmService/Stop", Right::Operates),
    ("/trocar.v1.GcmService/WaitFor", Right::Reads),
    ("/trocar.v1.GcmService/Watch", Right::Reads),
    ("/trocar.v1.GuestService/Hold", Right::Administers),
    ("/trocar.v1.GuestService/Join", Right::Administers),
    ("/trocar.v1.GuestService/Require", Right::Administers),
    ("/trocar.v1.InteractService/Emit", Right::Operates),
    ("/trocar.v1.InteractService/Invoke", Right::Reads),
    ("/trocar.v1.InteractService/Logs", Right::Reads),
    ("/trocar.v1.InteractService/Read", Right::Reads),
    ("/trocar.v1.InteractService/Subscribe", Right::Reads),
    ("/trocar.v1.PluginService/DescribePlugin", Right::Reads),
    ("/trocar.v1.PluginService/ListPlugins", Right::Reads),
    ("/trocar.v1.PluginService/Load", Right::Administers),
    ("/trocar.v1.PluginService/Recheck", Right::Administers),
    ("/trocar.v1.PluginService/Reload", Right::Administers),
    ("/trocar.v1.PluginService/Unload", Right::Administers),
    ("/grpc.health.v1.Health/Check", Right::Reads),
    ("/grpc.health.v1.Health/List", Right::Reads),
    ("/grpc.health.v1.Health/Watch", Right::Reads),
    ("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo", Right::Reads),
    ("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo", Right::Reads),
    ("/video.mjpeg", Right::Reads),
];

/// Returns the kind of the method of this path; `None`: nobody has said.
pub(super) fn right(path: &str) -> Option<Right> {
    METHODS.iter().find(|(method, _)| *method == path).map(|(_, right)| *right)
}

/// Tells whether a role may ask what does that. `for_own`: a host asks what a component can ask for, in the
/// name of one of its own.
pub(super) fn may(role: Role, right: Option<Right>, for_own: bool) -> bool {
    match (role, right) {
        (Role::Gcm, _) | (_, Some(Right::Reads | Right::Tells)) => true,
        (_, None) | (Role::Viewer, _) => false,
        (Role::Operator, Some(right)) => right == Right::Operates,
        (Role::Administrator, Some(right)) => right != Right::Attaches,
        (Role::Host, Some(right)) => right == Right::Attaches || for_own,
    }
}

/// Returns what a certificate has to say for a method.
pub(super) fn needed(right: Option<Right>) -> String {
    let all = Role::ALL.into_iter().filter(|role| may(*role, right, false));
    let all: Vec<&str> = all.map(Role::name).collect();
    format!("the role {}", all.join(" or "))
}

/// Tells whether a request that names this component is one of a process of the holder.
pub(super) fn is_own(holder: &Holder, component: Option<&str>) -> bool {
    let component = component.and_then(|path| ComponentId::parse(path).ok());
    component.is_some_and(|component| holder.is_process(component.process.as_str()))
}

/// Tells whether components can ask for the method of this path.
pub(super) fn is_of_components(path: &str) -> bool {
    ["/trocar.v1.GcmService/", "/trocar.v1.PluginService/"].iter().any(|service| path.starts_with(service))
}

/// Checks that a caller may speak as that process: one that has shown a certificate only as one that it
/// names.
///
/// # Errors
/// It names others, or none.
pub(in crate::control) fn is_process(peer: Option<&Peer>, what: &str, process: &str) -> Result<(), Refusal> {
    let Some(peer) = peer else { return Ok(()) };
    match peer.holder() {
        Some(holder) if !holder.is_process(process) => Err(Refusal::RoleForbidden {
            what: format!("{what} as process {process}"),
            caller: peer.to_string(),
            needs: format!("the process {process}"),
        }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::collections::BTreeSet;

    use prost_reflect::DescriptorPool;
    use trocar_proto::FILE_DESCRIPTOR_SET;

    use super::*;

    #[test]
    fn every_method_there_is_has_a_row() {
        let pool = DescriptorPool::decode(FILE_DESCRIPTOR_SET).unwrap();
        let all: BTreeSet<String> = pool
            .services()
            .flat_map(|s| s.methods().map(|m| format!("/{}/{}", s.full_name(), m.name())).collect::<Vec<_>>())
            .collect();
        let rows: Vec<&str> =
            METHODS.iter().map(|(path, _)| *path).filter(|m| m.starts_with("/trocar.")).collect();
        let judged: BTreeSet<String> = rows.iter().map(|m| (*m).to_owned()).collect();
        assert_eq!(judged, all, "say of a new method what it does (METHODS)");
        assert_eq!(judged.len(), rows.len(), "one row for each");
    }

    /// By rights: reads, operates, administers, attaches, a method that nobody has judged.
    #[test]
    fn each_role_has_its_rights_and_no_other() {
        let rights = [
            Some(Right::Reads),
            Some(Right::Operates),
            Some(Right::Administers),
            Some(Right::Attaches),
            None,
        ];
        for (role, of_itself, for_own) in [
            (Role::Viewer, [true, false, false, false, false], [true, false, false, false, false]),
            (Role::Operator, [true, true, false, false, false], [true, true, false, false, false]),
            (Role::Administrator, [true, true, true, false, false], [true, true, true, false, false]),
            (Role::Host, [true, false, false, true, false], [true, true, true, true, false]),
            (Role::Gcm, [true; 5], [true; 5]),
        ] {
            assert_eq!(rights.map(|right| may(role, right, false)), of_itself, "{role}");
            assert_eq!(rights.map(|right| may(role, right, true)), for_own, "{role} for its own");
            assert!(may(role, Some(Right::Tells), false), "{role} asks who leads");
        }
        assert_eq!(needed(Some(Right::Operates)), "the role operator or administrator or gcm");
        assert_eq!(needed(Some(Right::Attaches)), "the role host or gcm");
    }

    #[test]
    fn a_host_asks_for_its_own_components_alone() {
        let holder = Holder {
            name: "cart".into(),
            role: Role::Host,
            processes: vec!["cart-*".into()],
            serial: vec![1],
        };
        assert!(is_own(&holder, Some("cart-left/arm")));
        for other in [None, Some("left/arm"), Some("cart-left"), Some(""), Some("cart-left/a/b/c")] {
            assert!(!is_own(&holder, other), "{other:?}");
        }
    }
}
