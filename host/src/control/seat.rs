//! The port of a GCM among several: it answers by its reign while that holds, and otherwise says who leads.
//!
//! Invariant: each call asks the clock whether this GCM leads, not a flag that somebody has to lower. A Stop
//! passes as long as there are sessions to stop by, since it does no harm whoever leads.

use std::sync::{Arc, Weak};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::State;
use axum::http::Request;
use axum::response::{IntoResponse, Response};
use axum::routing::any;
use parking_lot::Mutex;
use tokio::sync::watch;
use tonic::codegen::Service;
use tonic::server::NamedService;
use tonic::service::Routes;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;
use trocar_model::Refusal;
use trocar_proto::v1::attach_service_server::AttachServiceServer;
use trocar_proto::v1::gcm_service_server::GcmServiceServer;
use trocar_proto::v1::guest_service_server::GuestServiceServer;
use trocar_proto::v1::interact_service_server::InteractServiceServer;
use trocar_proto::v1::plugin_service_server::PluginServiceServer;

use super::attach::AttachEdge;
use super::server::Edge;
use super::status::status;
use crate::gcm::Lead;

/// Interval at which health is looked after.
const LOOK: Duration = Duration::from_millis(100);
/// The one call that a GCM answers whose lead is in doubt.
const STOP: &str = "/trocar.v1.GcmService/Stop";
const HEALTH: &str = "/grpc.health.v1.Health/";

/// The services of `trocar.v1`.
const SERVICES: [&str; 5] = [
    GcmServiceServer::<Edge>::NAME,
    InteractServiceServer::<Edge>::NAME,
    PluginServiceServer::<Edge>::NAME,
    GuestServiceServer::<Edge>::NAME,
    AttachServiceServer::<AttachEdge>::NAME,
];

/// A handle; clones share one port.
#[derive(Clone)]
pub struct Seat {
    inner: Arc<Inner>,
}

struct Inner {
    now: Mutex<Now>,
    /// Answers to everything that is no question to a leader.
    idle: Router,
    health: HealthReporter,
}

#[derive(Clone)]
enum Now {
    /// Another GCM leads; nobody knows which where `leader` is empty.
    Follows {
        leader: String,
        why: String,
    },
    Leads(Arc<Reign>),
}

/// Answers of a GCM that leads.
struct Reign {
    lead: Lead,
    routes: Router,
    /// Streams that would never end by themselves end with it.
    _open: watch::Sender<()>,
}

impl Seat {
    /// `idle` answers while nobody leads here; it is made with [`refusing`].
    pub(super) fn new(idle: Routes, health: HealthReporter) -> Seat {
        let why = "it has not asked yet who leads".to_owned();
        let now = Mutex::new(Now::Follows { leader: String::new(), why });
        let seat = Seat { inner: Arc::new(Inner { now, idle: idle.into_axum_router(), health }) };
        tokio::spawn(tell_health(Arc::downgrade(&seat.inner)));
        seat
    }

    /// Everything that is asked of the port.
    pub(super) fn routes(&self) -> Routes {
        Router::new().fallback(answer).with_state(self.clone()).into()
    }

    /// Says from now on that another GCM leads. A reign before it ends, with its sessions.
    pub fn follows(&self, leader: &str) {
        self.is(Now::Follows { leader: leader.to_owned(), why: String::new() });
    }

    /// Says from now on that nobody knows who leads.
    pub fn knows_no_leader(&self, why: &str) {
        self.is(Now::Follows { leader: String::new(), why: why.to_owned() });
    }

    /// Answers by these routes as long as the lead holds.
    pub(super) fn leads(&self, lead: Lead, routes: Routes, open: watch::Sender<()>) {
        let routes = routes.into_axum_router();
        self.is(Now::Leads(Arc::new(Reign { lead, routes, _open: open })));
    }

    pub(super) fn health(&self) -> &HealthReporter {
        &self.inner.health
    }

    fn is(&self, now: Now) {
        let before = std::mem::replace(&mut *self.inner.now.lock(), now);
        // Outside of the lock: its streams end.
        drop(before);
    }
}

async fn answer(State(seat): State<Seat>, mut request: Request<Body>) -> Response {
    let now = seat.inner.now.lock().clone();
    let path = request.uri().path();
    let refusal = match &now {
        Now::Follows { leader, why } => Refusal::NotLeader { leader: leader.clone(), why: why.clone() },
        Now::Leads(_) if path.starts_with(HEALTH) => {
            return call(seat.inner.idle.clone(), request).await;
        }
        Now::Leads(reign) => match reign.lead.holds() {
            Err(refusal) if path != STOP => refusal,
            _ => {
                let routes = reign.routes.clone();
                // A call that waits does not keep the reign, whose end it may wait for.
                drop(now);
                return call(routes, request).await;
            }
        },
    };
    request.extensions_mut().insert(refusal);
    call(seat.inner.idle.clone(), request).await
}

async fn call(mut routes: Router, request: Request<Body>) -> Response {
    // A router is always ready, and never fails.
    match routes.call(request).await {
        Ok(response) => response,
        Err(never) => match never {},
    }
}

/// Adds the services of `trocar.v1`, each call of which is refused.
pub(super) fn refusing(others: Routes) -> Routes {
    let add = |router: Router, name: &&str| router.route(&format!("/{name}/{{method}}"), any(refused));
    SERVICES.iter().fold(others.into_axum_router(), add).into()
}

async fn refused(request: Request<Body>) -> Response {
    let refusal = request.extensions().get::<Refusal>().cloned();
    let unknown =
        || Refusal::NotLeader { leader: String::new(), why: "it has not asked yet who leads".into() };
    status(&refusal.unwrap_or_else(unknown)).into_http::<Body>().into_response()
}

/// Says over gRPC health whether this GCM leads, as long as the port is there.
async fn tell_health(seat: Weak<Inner>) {
    let mut told = None;
    loop {
        let Some(inner) = seat.upgrade() else { return };
        let leads = match &*inner.now.lock() {
            Now::Leads(reign) => reign.lead.holds().is_ok(),
            Now::Follows { .. } => false,
        };
        if told != Some(leads) {
            let health = if leads { ServingStatus::Serving } else { ServingStatus::NotServing };
            for service in SERVICES.iter().chain(&[""]) {
                inner.health.set_service_status(*service, health).await;
            }
            told = Some(leads);
        }
        drop(inner);
        tokio::time::sleep(LOOK).await;
    }
}
