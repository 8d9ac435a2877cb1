//! The token that a client sends when it was given one: by `TROCAR_TOKEN`, and only so.
//!
//! Invariant: a token is sent to an address only if the user of the client said so. A token sent unasked
//! would reach whatever program happens to listen there.

use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Request, Status};

/// A connection whose requests carry the token.
pub type Tokened = InterceptedService<Channel, Bearer>;

/// Puts the token of the environment into each request.
#[derive(Clone, Debug, Default)]
pub struct Bearer(Option<MetadataValue<Ascii>>);

impl Bearer {
    fn from_env() -> Bearer {
        let token = std::env::var("TROCAR_TOKEN").ok().filter(|token| !token.is_empty());
        // A text that no header can hold is no token; the server's refusal then says what is missing.
        Bearer(token.and_then(|token| format!("Bearer {}", token.trim()).parse().ok()))
    }
}

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(token) = &self.0 {
            request.metadata_mut().insert("authorization", token.clone());
        }
        Ok(request)
    }
}

/// Returns `channel` with the token of the environment, if there is one, in each request.
pub(crate) fn with_token(channel: Channel) -> Tokened {
    InterceptedService::new(channel, Bearer::from_env())
}
