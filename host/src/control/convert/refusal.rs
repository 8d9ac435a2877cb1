//! Refusals by their values, so that a remote caller gets the same sentence, code and help as a local one.

use trocar_model::Refusal;
use trocar_proto::v1;

pub(crate) fn refusal_info(refusal: &Refusal) -> v1::RefusalInfo {
    let values = refusal.values().into_iter();
    v1::RefusalInfo {
        kind: refusal.kind().into(),
        values: values.map(|(name, value)| (name.to_owned(), value.to_string())).collect(),
        text: refusal.to_string(),
    }
}

/// A kind this build does not know keeps its sentence.
pub(crate) fn refusal(info: &v1::RefusalInfo) -> Refusal {
    let value = |name: &str| serde_json::from_str(info.values.get(name)?).ok();
    Refusal::from_values(&info.kind, value).unwrap_or_else(|| Refusal::Internal { text: info.text.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_refusal_arrives_as_it_was_sent() {
        for sent in Refusal::examples() {
            let arrived = refusal(&refusal_info(&sent));
            assert_eq!(arrived, sent, "sent {sent:?}");
        }
    }

    #[test]
    fn a_refusal_of_a_newer_build_keeps_its_sentence() {
        let info = v1::RefusalInfo {
            kind: "Later".into(),
            text: "the moon is not full".into(),
            ..Default::default()
        };
        assert!(refusal(&info).to_string().contains("the moon is not full"));
        assert_eq!(refusal(&refusal_info(&refusal(&info))), refusal(&info));
    }
}
