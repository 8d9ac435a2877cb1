//! Requests of components against a GCM with a scripted LCM.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use super::*;
use crate::control::{PortRules, ServeConfig, Server};
use crate::gcm::fake::{FakeLcm, name};
use crate::gcm::{GcmConfig, Registration};
use crate::lcm::{Lcm, SERVICE_VERBS};

async fn gcm() -> (Gcm, Arc<FakeLcm>) {
    let (gcm, lcm) = (Gcm::start(GcmConfig::default()).await.unwrap(), FakeLcm::new("host"));
    let inventory = lcm.inventory().await.unwrap();
    gcm.register(Registration::new(name("host"), String::new()), lcm.clone(), inventory).await.unwrap();
    (gcm, lcm)
}

async fn ask(services: &GcmServices, request: Value) -> Value {
    let (tell, told) = tokio::sync::oneshot::channel();
    let from = ComponentId::parse("host/architect").unwrap();
    let reply = Box::new(move |text: String| tell.send(text).unwrap());
    services.request(from, request.to_string(), reply);
    serde_json::from_str(&told.await.unwrap()).unwrap()
}

#[tokio::test]
async fn a_component_creates_another_and_is_told_what_grpcurl_would_be() {
    let (gcm, _lcm) = gcm().await;
    let services = GcmServices::here(gcm.clone());
    let reply = ask(&services, json!({ "verb": "Create", "path": "host/a", "class": "arm" })).await;
    assert_eq!(reply["ok"], json!(true), "{reply}");
    assert_eq!(reply["response"]["path"], json!("host/a"), "{reply}");
    assert_eq!(reply["response"]["revision"], json!(gcm.graph().revision.to_string()), "{reply}");
    let state = ask(&services, json!({ "verb": "GetState", "path": "host/a" })).await;
    assert!(state["response"]["component"]["state"].is_string(), "{state}");
}

#[tokio::test]
async fn a_refusal_has_its_code_reason_sentence_and_remedy() {
    let services = GcmServices::here(gcm().await.0);
    let reply = ask(&services, json!({ "verb": "GetState", "path": "host/nobody" })).await;
    assert_eq!(
        (&reply["code"], &reply["reason"]),
        (&json!("NOT_FOUND"), &json!("COMPONENT_NOT_FOUND")),
        "{reply}"
    );
    assert!(
        !reply["message"].as_str().unwrap().is_empty() && !reply["help"].as_str().unwrap().is_empty(),
        "{reply}"
    );
}

#[tokio::test]
async fn every_verb_that_is_let_through_is_known_here() {
    let services = GcmServices::here(gcm().await.0);
    for verb in SERVICE_VERBS {
        let reply = ask(&services, json!({ "verb": verb, "noSuchField": 1 })).await;
        let said = reply["message"].as_str().unwrap();
        let wanted = if verb == "Watch" { "is a stream" } else { "noSuchField" };
        assert!(said.contains(wanted), "{verb}: {reply}");
        assert_eq!(reply["code"], json!("INVALID_ARGUMENT"), "{verb}: {reply}");
    }
    let reply = ask(&services, json!({ "verb": "Destroy" })).await;
    assert!(reply["message"].as_str().unwrap().contains("Create"), "{reply}");
}

#[tokio::test]
async fn what_is_not_in_this_version_is_answered_by_the_gcm_as_over_grpc() {
    let services = GcmServices::here(gcm().await.0);
    for (verb, instead) in [
        ("Replace", "create the component again"),
        ("Move", "in the other process"),
        ("Load", "plugin directory"),
        ("Unload", "plugin directory"),
    ] {
        let reply = ask(&services, json!({ "verb": verb })).await;
        assert_eq!(
            (&reply["code"], &reply["reason"]),
            (&json!("UNIMPLEMENTED"), &json!("NOT_IMPLEMENTED")),
            "{verb}: {reply}"
        );
        assert!(reply["help"].as_str().unwrap().contains(instead), "{verb}: {reply}");
    }
}

#[tokio::test]
async fn a_gcm_elsewhere_answers_the_same_and_its_loss_is_named() {
    let (gcm, lcm) = gcm().await;
    let server = Server::start(ServeConfig {
        listen: "127.0.0.1:0".into(),
        gcm: Some(gcm.clone()),
        local: Some((name("host"), lcm)),
        managed_by: None,
        rules: PortRules::default(),
        secured: None,
        runtime: None,
    });
    let server = server.await.unwrap();
    let addr = server.addr().to_string();
    let (here, there) = (GcmServices::here(gcm), GcmServices::at(&addr, &super::Dialler::local()).unwrap());
    for request in [
        json!({ "verb": "Create", "path": "host/a", "class": "arm", "requestId": "one" }),
        json!({ "verb": "List", "brief": true }),
        json!({ "verb": "Start", "path": "host/b" }),
    ] {
        assert_eq!(ask(&there, request.clone()).await, ask(&here, request.clone()).await, "{request}");
    }
    server.shutdown().await;
    let reply = ask(&there, json!({ "verb": "List" })).await;
    assert_eq!((&reply["code"], &reply["reason"]), (&json!("UNAVAILABLE"), &json!("NO_GCM")), "{reply}");
    assert!(reply["message"].as_str().unwrap().contains(&addr), "{reply}");
}
