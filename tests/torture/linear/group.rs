//! A few components that only connect among themselves, as a system that does one request after the other
//! would have them.
//!
//! Invariant: each answer has the condition under which it is given, so that an answer says what was there.
//! No request touches two groups, so a history is explained group by group.

use super::search::Model;

/// Components of a group that take something: each has one input.
pub(crate) const CLIENTS: usize = 2;
/// Components that give something; their numbers come after those of the clients.
pub(crate) const SERVERS: usize = 2;
pub(crate) const ALL: usize = CLIENTS + SERVERS;

pub(crate) struct Group;

/// State of a group: components, and whom each client is connected to.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct There {
    pub(crate) components: [bool; ALL],
    pub(crate) sources: [Option<usize>; CLIENTS],
}

/// A request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum What {
    Create(usize),
    Remove { component: usize, force: bool },
    Connect { client: usize, server: usize, replace: bool },
    Disconnect { client: usize, server: usize },
}

/// An answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Said {
    Done,
    /// Done, and there was nothing to do.
    Nothing,
    Exists,
    /// That component is not there.
    Missing(usize),
    InUse,
    ConnectionExists,
    /// The client has another source.
    AlreadyConnected,
    NoConnection,
}

#[derive(Clone, Debug)]
pub(crate) enum Call {
    Asked(What, Said),
    /// All of it was listed.
    Listed(There),
}

impl Model for Group {
    type State = There;
    type Call = Call;

    fn after(there: &There, call: &Call) -> Option<There> {
        match call {
            Call::Listed(listed) => (listed == there).then(|| there.clone()),
            Call::Asked(what, said) => {
                let (true_answer, after) = there.asked(*what);
                let is_it = true_answer == *said || there.is_gone_all_the_same(*what, *said);
                is_it.then(|| after.unwrap_or_else(|| there.clone()))
            }
        }
    }
}

impl There {
    /// The answer, and what is there then if that is something else.
    pub(crate) fn asked(&self, what: What) -> (Said, Option<There>) {
        let missing = |component: &usize| !self.components[*component];
        let mut after = self.clone();
        match what {
            What::Create(component) if self.components[component] => return (Said::Exists, None),
            What::Create(component) => after.components[component] = true,
            What::Remove { component, .. } if missing(&component) => return (Said::Missing(component), None),
            What::Remove { component, force } => {
                let touches = |client: usize| {
                    self.sources[client].is_some_and(|server| client == component || server == component)
                };
                let cut: Vec<usize> = (0..CLIENTS).filter(|client| touches(*client)).collect();
                if !cut.is_empty() && !force {
                    return (Said::InUse, None);
                }
                cut.into_iter().for_each(|client| after.sources[client] = None);
                after.components[component] = false;
            }
            What::Connect { client, server, replace } => {
                if let Some(missing) = [client, server].into_iter().find(missing) {
                    return (Said::Missing(missing), None);
                }
                match self.sources[client].filter(|_| !replace) {
                    Some(other) if other == server => return (Said::ConnectionExists, None),
                    Some(_) => return (Said::AlreadyConnected, None),
                    None => after.sources[client] = Some(server),
                }
            }
            What::Disconnect { client, server } if self.sources[client] == Some(server) => {
                after.sources[client] = None;
            }
            What::Disconnect { client, server } => {
                let missing = [client, server].into_iter().find(missing);
                return (missing.map_or(Said::NoConnection, Said::Missing), None);
            }
        }
        (Said::Done, Some(after))
    }

    /// A Remove by force that found the component gone when its turn came.
    fn is_gone_all_the_same(&self, what: What, said: Said) -> bool {
        matches!(what, What::Remove { component, force: true } if !self.components[component])
            && said == Said::Nothing
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linear::{Event, explain};

    const K: usize = 0;
    const S: usize = CLIENTS;
    const T: usize = CLIENTS + 1;

    /// Asked at `began` and answered one later.
    fn at(began: u64, what: What, said: Said) -> Event<Call> {
        during(began, began + 1, what, said)
    }

    fn during(began: u64, ended: u64, what: What, said: Said) -> Event<Call> {
        Event { call: Call::Asked(what, said), began, ended, is_lost: false, place: None }
    }

    fn lost(event: Event<Call>) -> Event<Call> {
        Event { is_lost: true, ..event }
    }

    fn is(events: &[Event<Call>]) -> bool {
        explain::<Group>(There::default(), events).is_ok()
    }

    fn connect(server: usize) -> What {
        What::Connect { client: K, server, replace: false }
    }

    fn remove(component: usize, force: bool) -> What {
        What::Remove { component, force }
    }

    /// Client and first server are there, and connected.
    fn connected() -> Vec<Event<Call>> {
        vec![
            at(0, What::Create(K), Said::Done),
            at(2, What::Create(S), Said::Done),
            at(4, connect(S), Said::Done),
        ]
    }

    fn then(more: &[Event<Call>]) -> bool {
        let mut events = connected();
        events.extend(more.iter().map(|event| Event { call: event.call.clone(), ..*event }));
        is(&events)
    }

    #[test]
    fn each_answer_is_given_where_its_condition_holds_and_nowhere_else() {
        use Said::*;
        let cut = |server| What::Disconnect { client: K, server };
        let anew = |server| What::Connect { client: K, server, replace: true };
        for (what, right) in [
            (What::Create(K), Exists),
            (What::Create(T), Done),
            (remove(T, false), Missing(T)),
            (remove(K, false), InUse),
            (remove(S, false), InUse),
            (remove(S, true), Done),
            (connect(S), ConnectionExists),
            (connect(T), Missing(T)),
            (anew(S), Done),
            (anew(T), Missing(T)),
            (cut(S), Done),
            (cut(T), Missing(T)),
            (What::Disconnect { client: 1, server: S }, Missing(1)),
        ] {
            for said in [
                Done,
                Nothing,
                Exists,
                Missing(K),
                Missing(1),
                Missing(T),
                InUse,
                ConnectionExists,
                NoConnection,
            ] {
                assert_eq!(then(&[at(6, what, said)]), said == right, "{what:?} {said:?}");
            }
        }
        let both = |more: Event<Call>| then(&[at(6, What::Create(T), Done), more]);
        assert!(both(at(8, connect(T), AlreadyConnected)) && !both(at(8, connect(T), Done)));
        assert!(both(at(8, cut(T), NoConnection)) && both(at(8, anew(T), Done)));
    }

    #[test]
    fn what_is_removed_by_force_takes_its_connections_along() {
        let gone = at(6, remove(S, true), Said::Done);
        let again = |said| then(&[at(6, remove(S, true), Said::Done), at(8, What::Create(S), said)]);
        assert!(again(Said::Done) && !again(Said::Exists));
        let listed = |source| {
            let mut there = There::default();
            (there.components[K], there.sources[K]) = (true, source);
            let listed = Call::Listed(there);
            then(&[
                Event { call: gone.call.clone(), ..gone },
                Event { call: listed, began: 8, ended: 9, is_lost: false, place: None },
            ])
        };
        assert!(listed(None) && !listed(Some(S)));
    }

    #[test]
    fn of_two_that_race_one_has_it_done() {
        let two = |first, second| {
            is(&[during(0, 9, What::Create(K), first), during(0, 9, What::Create(K), second)])
        };
        assert!(two(Said::Done, Said::Exists) && two(Said::Exists, Said::Done));
        assert!(!two(Said::Done, Said::Done) && !two(Said::Exists, Said::Exists));
        // By force, the second may find it gone when its turn comes; it is there when both ask.
        let removed = |second| {
            let mut events = vec![at(0, What::Create(K), Said::Done)];
            events.push(during(2, 9, remove(K, true), Said::Done));
            events.push(during(2, 9, remove(K, true), second));
            is(&events)
        };
        assert!(removed(Said::Missing(K)) && removed(Said::Nothing) && !removed(Said::Done));
    }

    #[test]
    fn an_answer_that_rests_on_what_is_lost_later_is_not_explained() {
        let created = lost(during(0, 5, What::Create(K), Said::Done));
        let seen = at(2, What::Create(K), Said::Exists);
        let gone = at(8, What::Create(K), Said::Done);
        assert!(is(&[created, seen]));
        let created = lost(during(0, 5, What::Create(K), Said::Done));
        let seen = at(2, What::Create(K), Said::Exists);
        assert!(!is(&[created, seen, gone]), "somebody was told that it exists, and nobody has removed it");
    }
}
