//! Stops and what became of them, both ways over an Attach stream.
//!
//! Invariant: decoding gives a value equal to the encoded one; a decision that no GCM gives is not taken.

use trocar_model::{ComponentId, Refusal, Target};
use trocar_proto::v1;

use super::back::unreadable;
use super::change::{report_in, state_in, state_out};
use super::graph::report;
use super::refusal::{refusal, refusal_info};
use crate::lcm::{Decision, Halted, Stop, StoppedHere};

pub(crate) fn stop_out(stop: &Stop) -> v1::StopOrder {
    v1::StopOrder { paths: paths(&stop.targets), known_here: stop.known_here }
}

pub(crate) fn stop_in(stop: v1::StopOrder) -> Result<Stop, Refusal> {
    Ok(Stop { targets: targets(&stop.paths)?, known_here: stop.known_here })
}

pub(crate) fn halted_out(halted: Vec<Halted>) -> v1::Halted {
    let one = |Halted { id, was, done }: Halted| v1::HaltedComponent {
        path: id.to_string(),
        was: Some(state_out(was)),
        report: done.as_ref().ok().map(report),
        refused: done.as_ref().err().map(refusal_info),
    };
    v1::Halted { components: halted.into_iter().map(one).collect() }
}

pub(crate) fn halted_in(halted: v1::Halted) -> Result<Vec<Halted>, Refusal> {
    let one = |h: v1::HaltedComponent| {
        let done = match (h.refused, h.report) {
            (Some(info), _) => Err(refusal(&info)),
            (None, Some(report)) => Ok(report_in(report)?),
            (None, None) => return Err(unreadable("halted component")),
        };
        Ok(Halted { id: ComponentId::parse(&h.path)?, was: state_in(h.was)?, done })
    };
    halted.components.into_iter().map(one).collect()
}

pub(crate) fn stopped_here_out(stopped: &StoppedHere) -> v1::StoppedHere {
    let (targets, numbers): (Vec<_>, Vec<_>) = stopped.targets.iter().cloned().unzip();
    v1::StoppedHere { number: stopped.number, paths: paths(&targets), numbers }
}

pub(crate) fn stopped_here_in(stopped: v1::StoppedHere) -> Result<StoppedHere, Refusal> {
    // The number of the last Stop stands for those that are missing.
    let numbers = stopped.numbers.into_iter().chain(std::iter::repeat(stopped.number));
    Ok(StoppedHere {
        number: stopped.number,
        targets: targets(&stopped.paths)?.into_iter().zip(numbers).collect(),
    })
}

/// # Errors
/// It is greater than any that a GCM gives: to count on from there would give none that is greater.
pub(crate) fn decision_in(number: u64) -> Result<Decision, Refusal> {
    let decision = Decision(number);
    if decision <= Decision::MOST { Ok(decision) } else { Err(unreadable("decision")) }
}

fn paths(targets: &[Target]) -> Vec<String> {
    targets.iter().map(ToString::to_string).collect()
}

fn targets(paths: &[String]) -> Result<Vec<Target>, Refusal> {
    paths.iter().map(|path| Target::parse(path)).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use trocar_model::{Health, State};

    use super::*;
    use crate::lcm::Report;

    #[test]
    fn stops_and_what_became_of_them_come_back_as_they_went() {
        let id = ComponentId::parse("host/arm").unwrap();
        let stop = Stop {
            targets: vec![Target::One(id.clone()), Target::parse("host/**").unwrap(), Target::everything()],
            known_here: 3,
        };
        assert_eq!(stop_in(stop_out(&stop)).unwrap(), stop);
        let told = StoppedHere { number: 4, targets: stop.targets.into_iter().zip([4, 2, 3]).collect() };
        assert_eq!(stopped_here_in(stopped_here_out(&told)).unwrap(), told);
        let untold = v1::StoppedHere { numbers: vec![4], ..stopped_here_out(&told) };
        assert!(stopped_here_in(untold).unwrap().targets.iter().all(|(_, number)| *number == 4));
        let report = Report {
            id: id.clone(),
            number: 9,
            state: State::Ready,
            health: Health::Ok,
            fault: String::new(),
            ports: None,
            lost_connections: Vec::new(),
            warnings: vec!["w".into()],
        };
        let refused = Refusal::ComponentFault { id: id.clone(), text: "stop: the cable is out".into() };
        for done in [Ok(report), Err(refused)] {
            let sent = Halted { id: id.clone(), was: State::Active, done };
            let [came] = halted_in(halted_out(vec![sent.clone()])).unwrap().try_into().unwrap();
            assert_eq!((&came.id, came.was, &came.done), (&sent.id, sent.was, &sent.done));
        }
        let halted = vec![v1::HaltedComponent { path: "host/arm".into(), ..Default::default() }];
        halted_in(v1::Halted { components: halted }).unwrap_err();
    }

    #[test]
    fn a_decision_that_leaves_no_greater_one_is_refused() {
        assert_eq!(decision_in(1 << 62).unwrap(), Decision::MOST);
        decision_in((1 << 62) + 1).unwrap_err();
        decision_in(u64::MAX).unwrap_err();
    }
}
