//! News told before an answer is entered before the answer is passed on.
//!
//! Promise: a caller that was told that something went wrong sees the result at the next look.

use super::*;

#[tokio::test]
async fn what_an_lcm_told_before_it_refused_is_in_the_graph_when_the_refusal_is() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a"), start("host/a")]).await.unwrap();
    for round in 0..20 {
        let fault = format!("command ctl/do: chaos {round}");
        lcm.become_state("host/a", State::Fault, &fault);
        // No other task has run on this thread since: without asking, the graph is behind.
        assert_ne!(component(&gcm.graph(), "host/a").fault, fault);
        gcm.hear_out(&name("host")).await;
        let stands = component(&gcm.graph(), "host/a");
        assert_eq!((stands.state, stands.fault), (State::Fault, fault));
    }
}

#[tokio::test]
async fn a_start_that_is_refused_shows_the_fault_it_ended_in() {
    let (gcm, lcm) = system().await;
    ask(&gcm, vec![create("host/a")]).await.unwrap();
    lcm.fault_at("Start host/a");
    let refusal = ask(&gcm, vec![start("host/a")]).await.unwrap_err();
    assert_eq!(refusal.reason(), "COMPONENT_FAULT");
    let stands = component(&gcm.graph(), "host/a");
    assert_eq!((stands.state, stands.fault.as_str()), (State::Fault, "start: the cable is out"));
}

#[tokio::test]
async fn what_a_process_that_is_gone_had_to_say_is_not_waited_for() {
    let (gcm, _lcm) = system().await;
    let epoch = gcm.graph().processes[&name("host")].epoch;
    gcm.lost(&name("host"), epoch);
    gcm.hear_out(&name("host")).await;
    gcm.hear_out(&name("nobody")).await;
}
