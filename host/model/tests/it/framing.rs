//! Effect of a port's coordinate frame on the fields of its payload.

use trocar_model::*;

use crate::scene::*;

fn vector(n: usize) -> Type {
    Type::Array { item: Box::new(f64_type()), n }
}

fn pose() -> Type {
    structure(
        "Pose",
        64,
        vec![
            field("stamp", 0, Type::Prim(Prim::Stamp), ""),
            field("position", 8, vector(3), "m"),
            field("orientation", 32, vector(4), ""),
        ],
    )
}

/// Names of fields and their frames.
fn frames(ty: &Type) -> Vec<(String, String)> {
    let Type::Struct(s) = ty else { panic!("{ty:?} is no struct") };
    s.fields.iter().map(|f| (f.name.clone(), f.frame.clone())).collect()
}

#[test]
fn the_frame_of_a_pose_is_that_of_its_position_and_orientation() {
    let framed = pose().in_frame("retina").unwrap();
    let want =
        [("stamp", ""), ("position", "retina"), ("orientation", "retina")].map(|(a, b)| (a.into(), b.into()));
    assert_eq!(frames(&framed), want);
    assert_eq!(framed.size(), pose().size());
    assert!(pose().accepts(&framed) && framed.accepts(&pose()), "one end may leave it open");
    let said = framed.first_difference(&pose().in_frame("robot").unwrap()).unwrap();
    assert_eq!(said, "field `position[…]` is in frame retina here and frame robot there");
}

#[test]
fn a_frame_reaches_poses_in_structs_lists_and_arrays_and_leaves_joints_alone() {
    let joints = Type::List { item: Box::new(f64_type()), n: 16 };
    let tools = Type::List { item: Box::new(pose()), n: 4 };
    let arm = structure(
        "Arm",
        136 + 64 + 264,
        vec![
            field("joints", 0, joints, "rad"),
            field("tip", 136, pose(), ""),
            field("tools", 200, tools, ""),
        ],
    );
    let framed = arm.in_frame("retina").unwrap();
    let want = [("joints", ""), ("tip", "retina"), ("tools", "retina")].map(|(a, b)| (a.into(), b.into()));
    assert_eq!(frames(&framed), want);
    let said = framed.first_difference(&arm.in_frame("robot").unwrap()).unwrap();
    assert!(said.starts_with("field `tip.position[…]`"), "{said}");
    let both = Type::Array { item: Box::new(pose()), n: 2 };
    assert!(both.in_frame("retina").unwrap().first_difference(&both.in_frame("robot").unwrap()).is_some());
}

#[test]
fn what_a_payload_says_itself_is_kept_and_where_nothing_is_left_to_say_it_is_refused() {
    let mut own = field("goal", 0, vector(3), "m");
    own.frame = "robot".into();
    let target = structure("Target", 48, vec![own, field("eye", 24, vector(3), "m")]);
    let want = [("goal", "robot"), ("eye", "retina")].map(|(a, b)| (a.into(), b.into()));
    assert_eq!(frames(&target.in_frame("retina").unwrap()), want);
    assert_eq!(target.in_frame("robot").unwrap().in_frame("retina"), None, "it is all said");
    for nothing in
        [f64_type(), vector(3), Type::Text { n: 8 }, Type::List { item: Box::new(vector(3)), n: 4 }]
    {
        assert_eq!(nothing.in_frame("retina"), None, "{nothing:?} has no fields");
    }
}
