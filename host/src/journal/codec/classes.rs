//! Classes, each said once in a message, and what names them by their index.
//!
//! Invariant: an index that is not there is refused; schemas and configurations are written as exact text.

use std::sync::Arc;

use serde_json::Value;
use trocar_model::{Change, ClassInfo, Component, ComponentId, Grant, Refusal, WantedComponent};
use trocar_proto::journal::v1 as wire;
use trocar_proto::v1;

use crate::control::convert::{
    change_in_with, change_out_with, class, class_in, execution, execution_out, state_in, state_out,
    unclassed_in, unclassed_out, unreadable, verb_in, verb_out,
};

/// Classes of a message that is being written.
#[derive(Default)]
pub(super) struct Classes(Vec<Arc<ClassInfo>>);

impl Classes {
    fn index(&mut self, class: &Arc<ClassInfo>) -> u32 {
        let same = |known: &Arc<ClassInfo>| Arc::ptr_eq(known, class) || known == class;
        let at = self.0.iter().position(same).unwrap_or_else(|| {
            self.0.push(class.clone());
            self.0.len() - 1
        });
        at as u32
    }

    pub(super) fn change(&mut self, change: &Change) -> wire::Change {
        let mut index = 0;
        let said = change_out_with(change, |id: &ComponentId, component: &Component| {
            index = self.index(&component.class);
            unclassed_out(id, component)
        });
        wire::Change { change: Some(said), class: index }
    }

    pub(super) fn component(&mut self, id: &ComponentId, c: &WantedComponent) -> wire::Component {
        wire::Component {
            path: id.to_string(),
            class: self.index(&c.class),
            config_json: c.config.to_string(),
            execution: Some(execution_out(&c.execution)),
            state: Some(state_out(c.state)),
            grant: c.grant.map(grant),
        }
    }

    pub(super) fn out(self) -> Vec<wire::Class> {
        self.0.iter().map(|c| one(c)).collect()
    }
}

fn one(c: &ClassInfo) -> wire::Class {
    let info = v1::ClassInfo { config_schema: None, ..class(c) };
    wire::Class { info: Some(info), config_schema_json: c.config_schema.to_string() }
}

/// Classes of a message that was read.
pub(super) struct Known(Vec<Arc<ClassInfo>>);

impl Known {
    pub(super) fn read(classes: Vec<wire::Class>) -> Result<Known, Refusal> {
        let one = |c: wire::Class| {
            let mut class = class_in(c.info.ok_or_else(|| unreadable("class"))?)?;
            class.config_schema = json(&c.config_schema_json, "config_schema_json")?;
            Ok(Arc::new(class))
        };
        classes.into_iter().map(one).collect::<Result<_, Refusal>>().map(Known)
    }

    fn class(&self, index: u32) -> Result<Arc<ClassInfo>, Refusal> {
        self.0.get(index as usize).cloned().ok_or_else(|| unreadable("class"))
    }

    pub(super) fn change(&self, change: wire::Change) -> Result<Change, Refusal> {
        let index = change.class;
        let change = change.change.ok_or_else(|| unreadable("change"))?;
        change_in_with(change, |component| unclassed_in(component, self.class(index)?))
    }

    pub(super) fn component(&self, c: wire::Component) -> Result<(ComponentId, WantedComponent), Refusal> {
        let component = WantedComponent {
            class: self.class(c.class)?,
            config: json(&c.config_json, "config_json")?,
            execution: execution(c.execution.ok_or_else(|| unreadable("execution"))?)?,
            state: state_in(c.state)?,
            grant: c.grant.map(grant_in).transpose()?,
        };
        Ok((ComponentId::parse(&c.path)?, component))
    }
}

fn json(text: &str, what: &str) -> Result<Value, Refusal> {
    serde_json::from_str(text).map_err(|_| unreadable(what))
}

fn grant(g: Grant) -> wire::Grant {
    wire::Grant { verb: verb_out(g.verb), revision: g.revision, epoch: g.epoch, decision: g.decision }
}

fn grant_in(g: wire::Grant) -> Result<Grant, Refusal> {
    let verb = verb_in(g.verb)?;
    Ok(Grant { verb, revision: g.revision, decision: g.decision, epoch: g.epoch })
}
