//! Temporary.
use crate::gcm::Registration;
use crate::lcm::Lcm;
use std::sync::Arc;
use trocar_model::Refusal;
pub struct Uplink;
impl Uplink {
    pub async fn start(_: String, _: Registration, _: Arc<dyn Lcm>) -> Result<Uplink, Refusal> {
        Err(Refusal::NotImplemented { what: "attaching".into(), hint: "later".into() })
    }
    pub async fn refused(&mut self) -> Refusal {
        std::future::pending().await
    }
    pub async fn shutdown(self) {}
}
