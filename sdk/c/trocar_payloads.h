/* The standard payloads of trocar for C11 and C++17: structs, and their types as the manifest wants them.
 *
 * Invariant: written from the Rust types (trocar_sdk::data) by a test of trocar-sdk; never edited by hand.
 *
 * Numbers are in SI units, the unit stands beside them. A stamp of 0 says that the value is not valid. A
 * field `reserved` is zero. In a list or text, what lies behind `len` is zero.
 *
 * TROCAR_TYPE_POSE and the like are string literals of JSON for the key "types" of a manifest:
 *   TROCAR_MANIFEST(TROCAR_JSON({"trocar":1, "types":[) TROCAR_TYPE_SCALAR TROCAR_JSON(], ...}));
 * In C++ the structs are trocar::data::Scalar, trocar::data::Pose and so on, as in Rust. */
#ifndef TROCAR_PAYLOADS_H
#define TROCAR_PAYLOADS_H

#include "trocar_plugin.h"
#ifdef __cplusplus
#include "trocar_values.hpp"
#endif

/* One number with its time: the simplest signal. */
typedef struct trocar_scalar {
    trocar_stamp stamp;
    double value;
} trocar_scalar;
TROCAR_ASSERT(sizeof(trocar_scalar) == 16, "trocar_scalar");
TROCAR_ASSERT(offsetof(trocar_scalar, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_scalar, value) == 8, "value");
#define TROCAR_TYPE_SCALAR \
    "{\"name\":\"Scalar\",\"doc\":\"One number with its time: the simplest signal.\",\"size\":16," \
    "\"align\":8,\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\"},{\"name\":\"value\",\"at\":8," \
    "\"type\":\"f64\"}]}"

#ifdef __cplusplus
typedef trocar::Text<240> trocar_text_240;
#else
typedef struct trocar_text_240 {
    uint64_t len;
    char room[240];
} trocar_text_240;
#endif
/* A line for people. */
typedef struct trocar_message {
    trocar_stamp stamp;
    trocar_text_240 text;
} trocar_message;
TROCAR_ASSERT(sizeof(trocar_message) == 256, "trocar_message");
TROCAR_ASSERT(offsetof(trocar_message, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_message, text) == 8, "text");
#define TROCAR_TYPE_MESSAGE \
    "{\"name\":\"Message\",\"doc\":\"A line for people.\",\"size\":256,\"align\":8," \
    "\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\"},{\"name\":\"text\",\"at\":8," \
    "\"type\":{\"text\":240}}]}"

/* A position and orientation (CRTK `measured_cp`), in the frame that the interface says. */
typedef struct trocar_pose {
    trocar_stamp stamp;
    double position[3]; /* m */
    /* Unit quaternion x, y, z, w. */
    double orientation[4];
} trocar_pose;
TROCAR_ASSERT(sizeof(trocar_pose) == 64, "trocar_pose");
TROCAR_ASSERT(offsetof(trocar_pose, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_pose, position) == 8, "position");
TROCAR_ASSERT(offsetof(trocar_pose, orientation) == 32, "orientation");
#define TROCAR_TYPE_POSE \
    "{\"name\":\"Pose\",\"doc\":\"A position and orientation (CRTK `measured_cp`), in the frame that the " \
    "interface says.\",\"size\":64,\"align\":8,\"fields\":[{\"name\":\"stamp\",\"at\":0," \
    "\"type\":\"stamp\"},{\"name\":\"position\",\"at\":8,\"type\":{\"array\":\"f64\",\"n\":3}," \
    "\"unit\":\"m\"},{\"name\":\"orientation\",\"at\":32,\"type\":{\"array\":\"f64\",\"n\":4}," \
    "\"doc\":\"Unit quaternion x, y, z, w.\"}]}"

/* Linear and angular velocity (CRTK `measured_cv`). */
typedef struct trocar_twist {
    trocar_stamp stamp;
    double linear[3]; /* m/s */
    double angular[3]; /* rad/s */
} trocar_twist;
TROCAR_ASSERT(sizeof(trocar_twist) == 56, "trocar_twist");
TROCAR_ASSERT(offsetof(trocar_twist, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_twist, linear) == 8, "linear");
TROCAR_ASSERT(offsetof(trocar_twist, angular) == 32, "angular");
#define TROCAR_TYPE_TWIST \
    "{\"name\":\"Twist\",\"doc\":\"Linear and angular velocity (CRTK `measured_cv`).\",\"size\":56," \
    "\"align\":8,\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\"},{\"name\":\"linear\"," \
    "\"at\":8,\"type\":{\"array\":\"f64\",\"n\":3},\"unit\":\"m/s\"},{\"name\":\"angular\",\"at\":32," \
    "\"type\":{\"array\":\"f64\",\"n\":3},\"unit\":\"rad/s\"}]}"

/* Force and torque (CRTK `measured_cf`). */
typedef struct trocar_wrench {
    trocar_stamp stamp;
    double force[3]; /* N */
    double torque[3]; /* N.m */
} trocar_wrench;
TROCAR_ASSERT(sizeof(trocar_wrench) == 56, "trocar_wrench");
TROCAR_ASSERT(offsetof(trocar_wrench, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_wrench, force) == 8, "force");
TROCAR_ASSERT(offsetof(trocar_wrench, torque) == 32, "torque");
#define TROCAR_TYPE_WRENCH \
    "{\"name\":\"Wrench\",\"doc\":\"Force and torque (CRTK `measured_cf`).\",\"size\":56,\"align\":8," \
    "\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\"},{\"name\":\"force\",\"at\":8," \
    "\"type\":{\"array\":\"f64\",\"n\":3},\"unit\":\"N\"},{\"name\":\"torque\",\"at\":32," \
    "\"type\":{\"array\":\"f64\",\"n\":3},\"unit\":\"N.m\"}]}"

/* Pose, twist and wrench of one instant (`measured_cs`). A part that is not measured keeps stamp 0. */
typedef struct trocar_cartesian_state {
    trocar_stamp stamp;
    trocar_pose pose;
    trocar_twist twist;
    trocar_wrench wrench;
} trocar_cartesian_state;
TROCAR_ASSERT(sizeof(trocar_cartesian_state) == 184, "trocar_cartesian_state");
TROCAR_ASSERT(offsetof(trocar_cartesian_state, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_cartesian_state, pose) == 8, "pose");
TROCAR_ASSERT(offsetof(trocar_cartesian_state, twist) == 72, "twist");
TROCAR_ASSERT(offsetof(trocar_cartesian_state, wrench) == 128, "wrench");
/* The manifest needs TROCAR_TYPE_POSE, TROCAR_TYPE_TWIST and TROCAR_TYPE_WRENCH beside it. */
#define TROCAR_TYPE_CARTESIAN_STATE \
    "{\"name\":\"CartesianState\",\"doc\":\"Pose, twist and wrench of one instant (`measured_cs`). A part " \
    "that is not measured keeps stamp 0.\",\"size\":184,\"align\":8,\"fields\":[{\"name\":\"stamp\"," \
    "\"at\":0,\"type\":\"stamp\"},{\"name\":\"pose\",\"at\":8,\"type\":{\"ref\":\"Pose\"}}," \
    "{\"name\":\"twist\",\"at\":72,\"type\":{\"ref\":\"Twist\"}},{\"name\":\"wrench\",\"at\":128," \
    "\"type\":{\"ref\":\"Wrench\"}}]}"

#ifdef __cplusplus
typedef trocar::Text<32> trocar_text_32;
#else
typedef struct trocar_text_32 {
    uint64_t len;
    char room[32];
} trocar_text_32;
#endif
/* A rigid transform between two named frames: takes coordinates in `child` to coordinates in `parent`. */
typedef struct trocar_transform {
    trocar_pose pose;
    trocar_text_32 parent;
    trocar_text_32 child;
} trocar_transform;
TROCAR_ASSERT(sizeof(trocar_transform) == 144, "trocar_transform");
TROCAR_ASSERT(offsetof(trocar_transform, pose) == 0, "pose");
TROCAR_ASSERT(offsetof(trocar_transform, parent) == 64, "parent");
TROCAR_ASSERT(offsetof(trocar_transform, child) == 104, "child");
/* The manifest needs TROCAR_TYPE_POSE beside it. */
#define TROCAR_TYPE_TRANSFORM \
    "{\"name\":\"Transform\",\"doc\":\"A rigid transform between two named frames: takes coordinates in " \
    "`child` to coordinates in `parent`.\",\"size\":144,\"align\":8,\"fields\":[{\"name\":\"pose\"," \
    "\"at\":0,\"type\":{\"ref\":\"Pose\"}},{\"name\":\"parent\",\"at\":64,\"type\":{\"text\":32}}," \
    "{\"name\":\"child\",\"at\":104,\"type\":{\"text\":32}}]}"

#ifdef __cplusplus
typedef trocar::List<double, 16> trocar_list_f64_16;
#else
typedef struct trocar_list_f64_16 {
    uint64_t len;
    double room[16];
} trocar_list_f64_16;
#endif
/* Joint vectors of a robot (CRTK `measured_js`, `setpoint_js`). Prismatic joints in m, revolute ones in
 * rad; the interface's `configuration_js` says which is which. */
typedef struct trocar_joint_state {
    trocar_stamp stamp;
    trocar_list_f64_16 position; /* m|rad */
    trocar_list_f64_16 velocity; /* m/s|rad/s */
    trocar_list_f64_16 effort; /* N|N.m */
} trocar_joint_state;
TROCAR_ASSERT(sizeof(trocar_joint_state) == 416, "trocar_joint_state");
TROCAR_ASSERT(offsetof(trocar_joint_state, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_joint_state, position) == 8, "position");
TROCAR_ASSERT(offsetof(trocar_joint_state, velocity) == 144, "velocity");
TROCAR_ASSERT(offsetof(trocar_joint_state, effort) == 280, "effort");
#define TROCAR_TYPE_JOINT_STATE \
    "{\"name\":\"JointState\",\"doc\":\"Joint vectors of a robot (CRTK `measured_js`, `setpoint_js`). " \
    "Prismatic joints in m, revolute ones in rad;\\nthe interface's `configuration_js` says which is " \
    "which.\",\"size\":416,\"align\":8,\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\"}," \
    "{\"name\":\"position\",\"at\":8,\"type\":{\"list\":\"f64\",\"n\":16},\"unit\":\"m|rad\"}," \
    "{\"name\":\"velocity\",\"at\":144,\"type\":{\"list\":\"f64\",\"n\":16},\"unit\":\"m/s|rad/s\"}," \
    "{\"name\":\"effort\",\"at\":280,\"type\":{\"list\":\"f64\",\"n\":16},\"unit\":\"N|N.m\"}]}"

typedef uint32_t trocar_joint_kind;
enum {
    TROCAR_JOINT_KIND_PRISMATIC = 1,
    TROCAR_JOINT_KIND_REVOLUTE = 2
};
#define TROCAR_TYPE_JOINT_KIND \
    "{\"name\":\"JointKind\",\"doc\":\"\",\"size\":4,\"align\":4,\"enum\":\"u32\"," \
    "\"values\":[{\"name\":\"PRISMATIC\",\"value\":1},{\"name\":\"REVOLUTE\",\"value\":2}]}"

#ifdef __cplusplus
typedef trocar::Text<16> trocar_text_16;
#else
typedef struct trocar_text_16 {
    uint64_t len;
    char room[16];
} trocar_text_16;
#endif
#ifdef __cplusplus
typedef trocar::List<trocar_text_16, 16> trocar_list_text_16_16;
#else
typedef struct trocar_list_text_16_16 {
    uint64_t len;
    trocar_text_16 room[16];
} trocar_list_text_16_16;
#endif
#ifdef __cplusplus
typedef trocar::List<trocar_joint_kind, 16> trocar_list_joint_kind_16;
#else
typedef struct trocar_list_joint_kind_16 {
    uint64_t len;
    trocar_joint_kind room[16];
} trocar_list_joint_kind_16;
#endif
/* Names, kinds and limits of the joints (CRTK `configuration_js`), one item per joint in each list. */
typedef struct trocar_joint_configuration {
    /* When these limits began to hold. */
    trocar_stamp stamp;
    trocar_list_text_16_16 names;
    trocar_list_joint_kind_16 kinds;
    trocar_list_f64_16 lower; /* m|rad */
    trocar_list_f64_16 upper; /* m|rad */
    /* Highest speed, to both sides. */
    trocar_list_f64_16 speed; /* m/s|rad/s */
    /* Highest acceleration, to both sides; empty where it is not limited. */
    trocar_list_f64_16 acceleration; /* m/s^2|rad/s^2 */
    /* Highest force or torque, to both sides; empty where it is not limited. */
    trocar_list_f64_16 effort; /* N|N.m */
} trocar_joint_configuration;
TROCAR_ASSERT(sizeof(trocar_joint_configuration) == 1152, "trocar_joint_configuration");
TROCAR_ASSERT(offsetof(trocar_joint_configuration, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_joint_configuration, names) == 8, "names");
TROCAR_ASSERT(offsetof(trocar_joint_configuration, kinds) == 400, "kinds");
TROCAR_ASSERT(offsetof(trocar_joint_configuration, lower) == 472, "lower");
TROCAR_ASSERT(offsetof(trocar_joint_configuration, upper) == 608, "upper");
TROCAR_ASSERT(offsetof(trocar_joint_configuration, speed) == 744, "speed");
TROCAR_ASSERT(offsetof(trocar_joint_configuration, acceleration) == 880, "acceleration");
TROCAR_ASSERT(offsetof(trocar_joint_configuration, effort) == 1016, "effort");
/* The manifest needs TROCAR_TYPE_JOINT_KIND beside it. */
#define TROCAR_TYPE_JOINT_CONFIGURATION \
    "{\"name\":\"JointConfiguration\",\"doc\":\"Names, kinds and limits of the joints (CRTK " \
    "`configuration_js`), one item per joint in each list.\",\"size\":1152,\"align\":8," \
    "\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\",\"doc\":\"When these limits began to " \
    "hold.\"},{\"name\":\"names\",\"at\":8,\"type\":{\"list\":{\"text\":16},\"n\":16}},{\"name\":\"kinds\"," \
    "\"at\":400,\"type\":{\"list\":{\"ref\":\"JointKind\"},\"n\":16}},{\"name\":\"lower\",\"at\":472," \
    "\"type\":{\"list\":\"f64\",\"n\":16},\"unit\":\"m|rad\"},{\"name\":\"upper\",\"at\":608," \
    "\"type\":{\"list\":\"f64\",\"n\":16},\"unit\":\"m|rad\"},{\"name\":\"speed\",\"at\":744," \
    "\"type\":{\"list\":\"f64\",\"n\":16},\"unit\":\"m/s|rad/s\",\"doc\":\"Highest speed, to both " \
    "sides.\"},{\"name\":\"acceleration\",\"at\":880,\"type\":{\"list\":\"f64\",\"n\":16}," \
    "\"unit\":\"m/s^2|rad/s^2\",\"doc\":\"Highest acceleration, to both sides; empty where it is not " \
    "limited.\"},{\"name\":\"effort\",\"at\":1016,\"type\":{\"list\":\"f64\",\"n\":16},\"unit\":\"N|N.m\"," \
    "\"doc\":\"Highest force or torque, to both sides; empty where it is not limited.\"}]}"

/* One sample of an arm's stream: joints, tip and wrench of the same instant, so they carry the same stamp;
 * a wrench that is not measured has stamp 0. */
typedef struct trocar_arm_state {
    trocar_stamp stamp;
    trocar_joint_state measured_js;
    trocar_pose measured_cp;
    /* As the read `measured_cf` of the arm: what the tip meets; stamp 0 where nothing measures it. */
    trocar_wrench measured_cf;
} trocar_arm_state;
TROCAR_ASSERT(sizeof(trocar_arm_state) == 544, "trocar_arm_state");
TROCAR_ASSERT(offsetof(trocar_arm_state, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_arm_state, measured_js) == 8, "measured_js");
TROCAR_ASSERT(offsetof(trocar_arm_state, measured_cp) == 424, "measured_cp");
TROCAR_ASSERT(offsetof(trocar_arm_state, measured_cf) == 488, "measured_cf");
/* The manifest needs TROCAR_TYPE_JOINT_STATE, TROCAR_TYPE_POSE and TROCAR_TYPE_WRENCH beside it. */
#define TROCAR_TYPE_ARM_STATE \
    "{\"name\":\"ArmState\",\"doc\":\"One sample of an arm's stream: joints, tip and wrench of the same " \
    "instant, so they carry the same stamp; a\\nwrench that is not measured has stamp 0.\",\"size\":544," \
    "\"align\":8,\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\"},{\"name\":\"measured_js\"," \
    "\"at\":8,\"type\":{\"ref\":\"JointState\"}},{\"name\":\"measured_cp\",\"at\":424," \
    "\"type\":{\"ref\":\"Pose\"}},{\"name\":\"measured_cf\",\"at\":488,\"type\":{\"ref\":\"Wrench\"}," \
    "\"doc\":\"As the read `measured_cf` of the arm: what the tip meets; stamp 0 where nothing measures " \
    "it.\"}]}"

typedef uint32_t trocar_operating_mode;
enum {
    TROCAR_OPERATING_MODE_DISABLED = 0,
    TROCAR_OPERATING_MODE_ENABLED = 1,
    TROCAR_OPERATING_MODE_PAUSED = 2,
    TROCAR_OPERATING_MODE_FAULT = 3
};
#define TROCAR_TYPE_OPERATING_MODE \
    "{\"name\":\"OperatingMode\",\"doc\":\"\",\"size\":4,\"align\":4,\"enum\":\"u32\"," \
    "\"values\":[{\"name\":\"DISABLED\",\"value\":0},{\"name\":\"ENABLED\",\"value\":1}," \
    "{\"name\":\"PAUSED\",\"value\":2},{\"name\":\"FAULT\",\"value\":3}]}"

#ifdef __cplusplus
typedef trocar::Text<128> trocar_text_128;
#else
typedef struct trocar_text_128 {
    uint64_t len;
    char room[128];
} trocar_text_128;
#endif
/* CRTK `operating_state`. */
typedef struct trocar_operating_state {
    trocar_stamp stamp;
    trocar_operating_mode state;
    uint8_t is_homed;
    uint8_t is_busy;
    uint8_t reserved[2];
    /* Why, in one sentence. */
    trocar_text_128 message;
} trocar_operating_state;
TROCAR_ASSERT(sizeof(trocar_operating_state) == 152, "trocar_operating_state");
TROCAR_ASSERT(offsetof(trocar_operating_state, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_operating_state, state) == 8, "state");
TROCAR_ASSERT(offsetof(trocar_operating_state, is_homed) == 12, "is_homed");
TROCAR_ASSERT(offsetof(trocar_operating_state, is_busy) == 13, "is_busy");
TROCAR_ASSERT(offsetof(trocar_operating_state, reserved) == 14, "reserved");
TROCAR_ASSERT(offsetof(trocar_operating_state, message) == 16, "message");
/* The manifest needs TROCAR_TYPE_OPERATING_MODE beside it. */
#define TROCAR_TYPE_OPERATING_STATE \
    "{\"name\":\"OperatingState\",\"doc\":\"CRTK `operating_state`.\",\"size\":152,\"align\":8," \
    "\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\"},{\"name\":\"state\",\"at\":8," \
    "\"type\":{\"ref\":\"OperatingMode\"}},{\"name\":\"is_homed\",\"at\":12,\"type\":\"bool\"}," \
    "{\"name\":\"is_busy\",\"at\":13,\"type\":\"bool\"},{\"name\":\"reserved\",\"at\":14," \
    "\"type\":{\"array\":\"u8\",\"n\":2}},{\"name\":\"message\",\"at\":16,\"type\":{\"text\":128}," \
    "\"doc\":\"Why, in one sentence.\"}]}"

typedef uint32_t trocar_fixture_kind;
enum {
    TROCAR_FIXTURE_KIND_PLANE = 1,
    TROCAR_FIXTURE_KIND_LINE = 2,
    TROCAR_FIXTURE_KIND_RCM = 3
};
#define TROCAR_TYPE_FIXTURE_KIND \
    "{\"name\":\"FixtureKind\",\"doc\":\"\",\"size\":4,\"align\":4,\"enum\":\"u32\"," \
    "\"values\":[{\"name\":\"PLANE\",\"value\":1},{\"name\":\"LINE\",\"value\":2},{\"name\":\"RCM\"," \
    "\"value\":3}]}"

/* A virtual fixture. */
typedef struct trocar_virtual_fixture {
    trocar_fixture_kind kind;
    uint32_t reserved;
    /* Where; commands take it in the arm's base frame. */
    trocar_pose frame;
    /* Towards the border the tip moves at most at this times the distance that is left, 0 = 20 /s. */
    double stiffness; /* 1/s */
} trocar_virtual_fixture;
TROCAR_ASSERT(sizeof(trocar_virtual_fixture) == 80, "trocar_virtual_fixture");
TROCAR_ASSERT(offsetof(trocar_virtual_fixture, kind) == 0, "kind");
TROCAR_ASSERT(offsetof(trocar_virtual_fixture, reserved) == 4, "reserved");
TROCAR_ASSERT(offsetof(trocar_virtual_fixture, frame) == 8, "frame");
TROCAR_ASSERT(offsetof(trocar_virtual_fixture, stiffness) == 72, "stiffness");
/* The manifest needs TROCAR_TYPE_FIXTURE_KIND and TROCAR_TYPE_POSE beside it. */
#define TROCAR_TYPE_VIRTUAL_FIXTURE \
    "{\"name\":\"VirtualFixture\",\"doc\":\"A virtual fixture.\",\"size\":80,\"align\":8," \
    "\"fields\":[{\"name\":\"kind\",\"at\":0,\"type\":{\"ref\":\"FixtureKind\"}},{\"name\":\"reserved\"," \
    "\"at\":4,\"type\":\"u32\"},{\"name\":\"frame\",\"at\":8,\"type\":{\"ref\":\"Pose\"},\"doc\":\"Where; " \
    "commands take it in the arm's base frame.\"},{\"name\":\"stiffness\",\"at\":72,\"type\":\"f64\"," \
    "\"unit\":\"1/s\",\"doc\":\"Towards the border the tip moves at most at this times the distance that " \
    "is left, 0 = 20 /s.\"}]}"

/* What an arm does by itself when a motion by velocity or force is not repeated in time: it brakes, waits,
 * and takes its tip back along the tool. */
typedef struct trocar_retreat {
    /* Back along the tool; 0 = it stays where it stands. */
    double distance; /* m */
    /* Of the tip, at most. */
    double speed; /* m/s */
    /* From the brake to the way back: who is only late finds the tip where it was. */
    double delay; /* s */
} trocar_retreat;
TROCAR_ASSERT(sizeof(trocar_retreat) == 24, "trocar_retreat");
TROCAR_ASSERT(offsetof(trocar_retreat, distance) == 0, "distance");
TROCAR_ASSERT(offsetof(trocar_retreat, speed) == 8, "speed");
TROCAR_ASSERT(offsetof(trocar_retreat, delay) == 16, "delay");
#define TROCAR_TYPE_RETREAT \
    "{\"name\":\"Retreat\",\"doc\":\"What an arm does by itself when a motion by velocity or force is not " \
    "repeated in time: it brakes, waits,\\nand takes its tip back along the tool.\",\"size\":24," \
    "\"align\":8,\"fields\":[{\"name\":\"distance\",\"at\":0,\"type\":\"f64\",\"unit\":\"m\"," \
    "\"doc\":\"Back along the tool; 0 = it stays where it stands.\"},{\"name\":\"speed\",\"at\":8," \
    "\"type\":\"f64\",\"unit\":\"m/s\",\"doc\":\"Of the tip, at most.\"},{\"name\":\"delay\",\"at\":16," \
    "\"type\":\"f64\",\"unit\":\"s\",\"doc\":\"From the brake to the way back: who is only late finds the " \
    "tip where it was.\"}]}"

typedef uint32_t trocar_tool_status;
enum {
    TROCAR_TOOL_STATUS_MISSING = 0,
    TROCAR_TOOL_STATUS_TRACKED = 1,
    TROCAR_TOOL_STATUS_PARTLY_HIDDEN = 2,
    TROCAR_TOOL_STATUS_AT_BORDER = 3
};
#define TROCAR_TYPE_TOOL_STATUS \
    "{\"name\":\"ToolStatus\",\"doc\":\"\",\"size\":4,\"align\":4,\"enum\":\"u32\"," \
    "\"values\":[{\"name\":\"MISSING\",\"value\":0},{\"name\":\"TRACKED\",\"value\":1}," \
    "{\"name\":\"PARTLY_HIDDEN\",\"value\":2},{\"name\":\"AT_BORDER\",\"value\":3}]}"

/* One tool as a tracker sees it. */
typedef struct trocar_tool_pose {
    /* The tool's name, as configured. */
    trocar_text_16 tool;
    /* In the tracker's own frame; stamp 0 when the tool is not in view. */
    trocar_pose pose;
    /* Root mean square distance of the markers from where the pose puts them. */
    double error; /* m */
    trocar_tool_status status;
    uint32_t reserved;
} trocar_tool_pose;
TROCAR_ASSERT(sizeof(trocar_tool_pose) == 104, "trocar_tool_pose");
TROCAR_ASSERT(offsetof(trocar_tool_pose, tool) == 0, "tool");
TROCAR_ASSERT(offsetof(trocar_tool_pose, pose) == 24, "pose");
TROCAR_ASSERT(offsetof(trocar_tool_pose, error) == 88, "error");
TROCAR_ASSERT(offsetof(trocar_tool_pose, status) == 96, "status");
TROCAR_ASSERT(offsetof(trocar_tool_pose, reserved) == 100, "reserved");
/* The manifest needs TROCAR_TYPE_POSE and TROCAR_TYPE_TOOL_STATUS beside it. */
#define TROCAR_TYPE_TOOL_POSE \
    "{\"name\":\"ToolPose\",\"doc\":\"One tool as a tracker sees it.\",\"size\":104,\"align\":8," \
    "\"fields\":[{\"name\":\"tool\",\"at\":0,\"type\":{\"text\":16},\"doc\":\"The tool's name, as " \
    "configured.\"},{\"name\":\"pose\",\"at\":24,\"type\":{\"ref\":\"Pose\"},\"doc\":\"In the tracker's " \
    "own frame; stamp 0 when the tool is not in view.\"},{\"name\":\"error\",\"at\":88,\"type\":\"f64\"," \
    "\"unit\":\"m\",\"doc\":\"Root mean square distance of the markers from where the pose puts them.\"}," \
    "{\"name\":\"status\",\"at\":96,\"type\":{\"ref\":\"ToolStatus\"}},{\"name\":\"reserved\",\"at\":100," \
    "\"type\":\"u32\"}]}"

#ifdef __cplusplus
typedef trocar::List<trocar_tool_pose, 8> trocar_list_tool_pose_8;
#else
typedef struct trocar_list_tool_pose_8 {
    uint64_t len;
    trocar_tool_pose room[8];
} trocar_list_tool_pose_8;
#endif
/* All tools of one measurement. */
typedef struct trocar_tracked_tools {
    /* When the tracker measured. */
    trocar_stamp stamp;
    /* Counts the tracker's measurements, from 0. */
    uint64_t index;
    trocar_list_tool_pose_8 tools;
} trocar_tracked_tools;
TROCAR_ASSERT(sizeof(trocar_tracked_tools) == 856, "trocar_tracked_tools");
TROCAR_ASSERT(offsetof(trocar_tracked_tools, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_tracked_tools, index) == 8, "index");
TROCAR_ASSERT(offsetof(trocar_tracked_tools, tools) == 16, "tools");
/* The manifest needs TROCAR_TYPE_TOOL_POSE beside it. */
#define TROCAR_TYPE_TRACKED_TOOLS \
    "{\"name\":\"TrackedTools\",\"doc\":\"All tools of one measurement.\",\"size\":856,\"align\":8," \
    "\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\",\"doc\":\"When the tracker measured.\"}," \
    "{\"name\":\"index\",\"at\":8,\"type\":\"u64\",\"doc\":\"Counts the tracker's measurements, from 0.\"}," \
    "{\"name\":\"tools\",\"at\":16,\"type\":{\"list\":{\"ref\":\"ToolPose\"},\"n\":8}}]}"

/* What a force sensor can measure (`range`), each component to both sides; 0 = does not measure it. */
typedef struct trocar_force_range {
    double force[3]; /* N */
    double torque[3]; /* N.m */
    /* Standard deviation of one sample's force. */
    double force_noise; /* N */
    /* Standard deviation of one sample's torque. */
    double torque_noise; /* N.m */
    double rate; /* Hz */
} trocar_force_range;
TROCAR_ASSERT(sizeof(trocar_force_range) == 72, "trocar_force_range");
TROCAR_ASSERT(offsetof(trocar_force_range, force) == 0, "force");
TROCAR_ASSERT(offsetof(trocar_force_range, torque) == 24, "torque");
TROCAR_ASSERT(offsetof(trocar_force_range, force_noise) == 48, "force_noise");
TROCAR_ASSERT(offsetof(trocar_force_range, torque_noise) == 56, "torque_noise");
TROCAR_ASSERT(offsetof(trocar_force_range, rate) == 64, "rate");
#define TROCAR_TYPE_FORCE_RANGE \
    "{\"name\":\"ForceRange\",\"doc\":\"What a force sensor can measure (`range`), each component to both " \
    "sides; 0 = does not measure it.\",\"size\":72,\"align\":8,\"fields\":[{\"name\":\"force\",\"at\":0," \
    "\"type\":{\"array\":\"f64\",\"n\":3},\"unit\":\"N\"},{\"name\":\"torque\",\"at\":24," \
    "\"type\":{\"array\":\"f64\",\"n\":3},\"unit\":\"N.m\"},{\"name\":\"force_noise\",\"at\":48," \
    "\"type\":\"f64\",\"unit\":\"N\",\"doc\":\"Standard deviation of one sample's force.\"}," \
    "{\"name\":\"torque_noise\",\"at\":56,\"type\":\"f64\",\"unit\":\"N.m\",\"doc\":\"Standard deviation " \
    "of one sample's torque.\"},{\"name\":\"rate\",\"at\":64,\"type\":\"f64\",\"unit\":\"Hz\"}]}"

#ifdef __cplusplus
typedef trocar::List<uint8_t, 32> trocar_list_bool_32;
#else
typedef struct trocar_list_bool_32 {
    uint64_t len;
    uint8_t room[32];
} trocar_list_bool_32;
#endif
/* Axes and buttons of an input device: pedal, joystick, gamepad. */
typedef struct trocar_input_state {
    trocar_stamp stamp;
    /* -1 to 1, a pedal 0 to 1; 0 at rest. */
    trocar_list_f64_16 axes;
    /* True while pressed. */
    trocar_list_bool_32 buttons;
    /* The device answers; when it does not, every axis is 0 and no button is pressed. */
    uint8_t connected;
    uint8_t reserved[7];
} trocar_input_state;
TROCAR_ASSERT(sizeof(trocar_input_state) == 192, "trocar_input_state");
TROCAR_ASSERT(offsetof(trocar_input_state, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_input_state, axes) == 8, "axes");
TROCAR_ASSERT(offsetof(trocar_input_state, buttons) == 144, "buttons");
TROCAR_ASSERT(offsetof(trocar_input_state, connected) == 184, "connected");
TROCAR_ASSERT(offsetof(trocar_input_state, reserved) == 185, "reserved");
#define TROCAR_TYPE_INPUT_STATE \
    "{\"name\":\"InputState\",\"doc\":\"Axes and buttons of an input device: pedal, joystick, gamepad.\"," \
    "\"size\":192,\"align\":8,\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\"}," \
    "{\"name\":\"axes\",\"at\":8,\"type\":{\"list\":\"f64\",\"n\":16},\"doc\":\"-1 to 1, a pedal 0 to 1; 0 " \
    "at rest.\"},{\"name\":\"buttons\",\"at\":144,\"type\":{\"list\":\"bool\",\"n\":32},\"doc\":\"True " \
    "while pressed.\"},{\"name\":\"connected\",\"at\":184,\"type\":\"bool\",\"doc\":\"The device answers; " \
    "when it does not, every axis is 0 and no button is pressed.\"},{\"name\":\"reserved\",\"at\":185," \
    "\"type\":{\"array\":\"u8\",\"n\":7}}]}"

#ifdef __cplusplus
typedef trocar::List<trocar_text_16, 32> trocar_list_text_16_32;
#else
typedef struct trocar_list_text_16_32 {
    uint64_t len;
    trocar_text_16 room[32];
} trocar_list_text_16_32;
#endif
/* Names of an input device's axes and buttons, in the order of `InputState`. */
typedef struct trocar_input_layout {
    trocar_list_text_16_16 axes;
    trocar_list_text_16_32 buttons;
} trocar_input_layout;
TROCAR_ASSERT(sizeof(trocar_input_layout) == 1168, "trocar_input_layout");
TROCAR_ASSERT(offsetof(trocar_input_layout, axes) == 0, "axes");
TROCAR_ASSERT(offsetof(trocar_input_layout, buttons) == 392, "buttons");
#define TROCAR_TYPE_INPUT_LAYOUT \
    "{\"name\":\"InputLayout\",\"doc\":\"Names of an input device's axes and buttons, in the order of " \
    "`InputState`.\",\"size\":1168,\"align\":8,\"fields\":[{\"name\":\"axes\",\"at\":0," \
    "\"type\":{\"list\":{\"text\":16},\"n\":16}},{\"name\":\"buttons\",\"at\":392," \
    "\"type\":{\"list\":{\"text\":16},\"n\":32}}]}"

/* A button of an input device changed. */
typedef struct trocar_button_event {
    trocar_stamp stamp;
    /* Position in `InputState::buttons`. */
    uint32_t button;
    uint8_t pressed;
    uint8_t reserved[3];
} trocar_button_event;
TROCAR_ASSERT(sizeof(trocar_button_event) == 16, "trocar_button_event");
TROCAR_ASSERT(offsetof(trocar_button_event, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_button_event, button) == 8, "button");
TROCAR_ASSERT(offsetof(trocar_button_event, pressed) == 12, "pressed");
TROCAR_ASSERT(offsetof(trocar_button_event, reserved) == 13, "reserved");
#define TROCAR_TYPE_BUTTON_EVENT \
    "{\"name\":\"ButtonEvent\",\"doc\":\"A button of an input device changed.\",\"size\":16,\"align\":8," \
    "\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\"},{\"name\":\"button\",\"at\":8," \
    "\"type\":\"u32\",\"doc\":\"Position in `InputState::buttons`.\"},{\"name\":\"pressed\",\"at\":12," \
    "\"type\":\"bool\"},{\"name\":\"reserved\",\"at\":13,\"type\":{\"array\":\"u8\",\"n\":3}}]}"

typedef uint32_t trocar_pixel_format;
enum {
    TROCAR_PIXEL_FORMAT_GRAY8 = 1,
    TROCAR_PIXEL_FORMAT_RGB8 = 2,
    TROCAR_PIXEL_FORMAT_BGR8 = 3,
    TROCAR_PIXEL_FORMAT_RGBA8 = 4,
    TROCAR_PIXEL_FORMAT_GRAY16 = 5,
    TROCAR_PIXEL_FORMAT_BAYER_RG8 = 6,
    TROCAR_PIXEL_FORMAT_YUYV = 7,
    TROCAR_PIXEL_FORMAT_DISPARITY16 = 8,
    TROCAR_PIXEL_FORMAT_DEPTH32F = 9
};
#define TROCAR_TYPE_PIXEL_FORMAT \
    "{\"name\":\"PixelFormat\",\"doc\":\"\",\"size\":4,\"align\":4,\"enum\":\"u32\"," \
    "\"values\":[{\"name\":\"GRAY8\",\"value\":1},{\"name\":\"RGB8\",\"value\":2},{\"name\":\"BGR8\"," \
    "\"value\":3},{\"name\":\"RGBA8\",\"value\":4},{\"name\":\"GRAY16\",\"value\":5}," \
    "{\"name\":\"BAYER_RG8\",\"value\":6},{\"name\":\"YUYV\",\"value\":7},{\"name\":\"DISPARITY16\"," \
    "\"value\":8},{\"name\":\"DEPTH32F\",\"value\":9}]}"

/* Header of an image frame. */
typedef struct trocar_image_header {
    /* When the image was taken. */
    trocar_stamp stamp;
    /* Counts the source's images, from 0. */
    uint64_t index;
    uint32_t width; /* px */
    uint32_t height; /* px */
    /* From one row to the next. */
    uint32_t stride; /* B */
    trocar_pixel_format format;
} trocar_image_header;
TROCAR_ASSERT(sizeof(trocar_image_header) == 32, "trocar_image_header");
TROCAR_ASSERT(offsetof(trocar_image_header, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_image_header, index) == 8, "index");
TROCAR_ASSERT(offsetof(trocar_image_header, width) == 16, "width");
TROCAR_ASSERT(offsetof(trocar_image_header, height) == 20, "height");
TROCAR_ASSERT(offsetof(trocar_image_header, stride) == 24, "stride");
TROCAR_ASSERT(offsetof(trocar_image_header, format) == 28, "format");
/* The manifest needs TROCAR_TYPE_PIXEL_FORMAT beside it. */
#define TROCAR_TYPE_IMAGE_HEADER \
    "{\"name\":\"ImageHeader\",\"doc\":\"Header of an image frame.\",\"size\":32,\"align\":8," \
    "\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\",\"doc\":\"When the image was taken.\"}," \
    "{\"name\":\"index\",\"at\":8,\"type\":\"u64\",\"doc\":\"Counts the source's images, from 0.\"}," \
    "{\"name\":\"width\",\"at\":16,\"type\":\"u32\",\"unit\":\"px\"},{\"name\":\"height\",\"at\":20," \
    "\"type\":\"u32\",\"unit\":\"px\"},{\"name\":\"stride\",\"at\":24,\"type\":\"u32\",\"unit\":\"B\"," \
    "\"doc\":\"From one row to the next.\"},{\"name\":\"format\",\"at\":28," \
    "\"type\":{\"ref\":\"PixelFormat\"}}]}"

/* Header of a stereo pair: two images of one size and format in one frame. */
typedef struct trocar_stereo_header {
    /* When the pair was taken. */
    trocar_stamp stamp;
    /* Counts the source's pairs, from 0. */
    uint64_t index;
    /* Of one image. */
    uint32_t width; /* px */
    uint32_t height; /* px */
    /* From one row to the next. */
    uint32_t stride; /* B */
    trocar_pixel_format format;
    /* Where the right image begins; the left one begins at 0. */
    uint64_t right_offset; /* B */
} trocar_stereo_header;
TROCAR_ASSERT(sizeof(trocar_stereo_header) == 40, "trocar_stereo_header");
TROCAR_ASSERT(offsetof(trocar_stereo_header, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_stereo_header, index) == 8, "index");
TROCAR_ASSERT(offsetof(trocar_stereo_header, width) == 16, "width");
TROCAR_ASSERT(offsetof(trocar_stereo_header, height) == 20, "height");
TROCAR_ASSERT(offsetof(trocar_stereo_header, stride) == 24, "stride");
TROCAR_ASSERT(offsetof(trocar_stereo_header, format) == 28, "format");
TROCAR_ASSERT(offsetof(trocar_stereo_header, right_offset) == 32, "right_offset");
/* The manifest needs TROCAR_TYPE_PIXEL_FORMAT beside it. */
#define TROCAR_TYPE_STEREO_HEADER \
    "{\"name\":\"StereoHeader\",\"doc\":\"Header of a stereo pair: two images of one size and format in " \
    "one frame.\",\"size\":40,\"align\":8,\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\"," \
    "\"doc\":\"When the pair was taken.\"},{\"name\":\"index\",\"at\":8,\"type\":\"u64\",\"doc\":\"Counts " \
    "the source's pairs, from 0.\"},{\"name\":\"width\",\"at\":16,\"type\":\"u32\",\"unit\":\"px\"," \
    "\"doc\":\"Of one image.\"},{\"name\":\"height\",\"at\":20,\"type\":\"u32\",\"unit\":\"px\"}," \
    "{\"name\":\"stride\",\"at\":24,\"type\":\"u32\",\"unit\":\"B\",\"doc\":\"From one row to the next.\"}," \
    "{\"name\":\"format\",\"at\":28,\"type\":{\"ref\":\"PixelFormat\"}},{\"name\":\"right_offset\"," \
    "\"at\":32,\"type\":\"u64\",\"unit\":\"B\",\"doc\":\"Where the right image begins; the left one begins " \
    "at 0.\"}]}"

/* Size and rate of a camera (`camera_geometry`). */
typedef struct trocar_camera_geometry {
    /* Of one image. */
    uint32_t width; /* px */
    uint32_t height; /* px */
    /* Images or pairs per second; 0 before the first one. */
    double fps; /* Hz */
} trocar_camera_geometry;
TROCAR_ASSERT(sizeof(trocar_camera_geometry) == 16, "trocar_camera_geometry");
TROCAR_ASSERT(offsetof(trocar_camera_geometry, width) == 0, "width");
TROCAR_ASSERT(offsetof(trocar_camera_geometry, height) == 4, "height");
TROCAR_ASSERT(offsetof(trocar_camera_geometry, fps) == 8, "fps");
#define TROCAR_TYPE_CAMERA_GEOMETRY \
    "{\"name\":\"CameraGeometry\",\"doc\":\"Size and rate of a camera (`camera_geometry`).\",\"size\":16," \
    "\"align\":8,\"fields\":[{\"name\":\"width\",\"at\":0,\"type\":\"u32\",\"unit\":\"px\",\"doc\":\"Of " \
    "one image.\"},{\"name\":\"height\",\"at\":4,\"type\":\"u32\",\"unit\":\"px\"},{\"name\":\"fps\"," \
    "\"at\":8,\"type\":\"f64\",\"unit\":\"Hz\",\"doc\":\"Images or pairs per second; 0 before the first " \
    "one.\"}]}"

typedef uint32_t trocar_sample_format;
enum {
    TROCAR_SAMPLE_FORMAT_U16 = 1,
    TROCAR_SAMPLE_FORMAT_F32 = 2,
    TROCAR_SAMPLE_FORMAT_U8 = 3
};
#define TROCAR_TYPE_SAMPLE_FORMAT \
    "{\"name\":\"SampleFormat\",\"doc\":\"\",\"size\":4,\"align\":4,\"enum\":\"u32\"," \
    "\"values\":[{\"name\":\"U16\",\"value\":1},{\"name\":\"F32\",\"value\":2},{\"name\":\"U8\"," \
    "\"value\":3}]}"

/* Header of a frame of raw spectra: `lines` exposures one after the other, each of `samples` pixels of the
 * detector. */
typedef struct trocar_spectra_header {
    /* Middle of the first line's exposure. */
    trocar_stamp stamp;
    /* Counts the source's lines, from 0; that of the first line here. */
    uint64_t index;
    /* Exposures in this frame. */
    uint32_t lines;
    /* Pixels of one line. */
    uint32_t samples; /* px */
    trocar_sample_format format;
    /* Bits of a value that the detector fills, at most those of the format. */
    uint32_t bits;
    /* From the middle of one exposure to that of the next. */
    double line_period; /* s */
} trocar_spectra_header;
TROCAR_ASSERT(sizeof(trocar_spectra_header) == 40, "trocar_spectra_header");
TROCAR_ASSERT(offsetof(trocar_spectra_header, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_spectra_header, index) == 8, "index");
TROCAR_ASSERT(offsetof(trocar_spectra_header, lines) == 16, "lines");
TROCAR_ASSERT(offsetof(trocar_spectra_header, samples) == 20, "samples");
TROCAR_ASSERT(offsetof(trocar_spectra_header, format) == 24, "format");
TROCAR_ASSERT(offsetof(trocar_spectra_header, bits) == 28, "bits");
TROCAR_ASSERT(offsetof(trocar_spectra_header, line_period) == 32, "line_period");
/* The manifest needs TROCAR_TYPE_SAMPLE_FORMAT beside it. */
#define TROCAR_TYPE_SPECTRA_HEADER \
    "{\"name\":\"SpectraHeader\",\"doc\":\"Header of a frame of raw spectra: `lines` exposures one after " \
    "the other, each of `samples` pixels of the\\ndetector.\",\"size\":40,\"align\":8," \
    "\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\",\"doc\":\"Middle of the first line's " \
    "exposure.\"},{\"name\":\"index\",\"at\":8,\"type\":\"u64\",\"doc\":\"Counts the source's lines, from " \
    "0; that of the first line here.\"},{\"name\":\"lines\",\"at\":16,\"type\":\"u32\",\"doc\":\"Exposures " \
    "in this frame.\"},{\"name\":\"samples\",\"at\":20,\"type\":\"u32\",\"unit\":\"px\",\"doc\":\"Pixels " \
    "of one line.\"},{\"name\":\"format\",\"at\":24,\"type\":{\"ref\":\"SampleFormat\"}}," \
    "{\"name\":\"bits\",\"at\":28,\"type\":\"u32\",\"doc\":\"Bits of a value that the detector fills, at " \
    "most those of the format.\"},{\"name\":\"line_period\",\"at\":32,\"type\":\"f64\",\"unit\":\"s\"," \
    "\"doc\":\"From the middle of one exposure to that of the next.\"}]}"

/* Header of a frame of A-scans: `lines` depth profiles one after the other, each of `samples` bins, in dB
 * for `F32`. */
typedef struct trocar_a_scan_header {
    /* That of the spectra it was made of. */
    trocar_stamp stamp;
    /* That of the spectra it was made of. */
    uint64_t index;
    /* Depth profiles in this frame. */
    uint32_t lines;
    /* Bins of one profile. */
    uint32_t samples; /* px */
    trocar_sample_format format;
    uint32_t reserved;
    /* From one line to the next. */
    double line_period; /* s */
    /* Optical path from one bin to the next: depth times index of refraction. */
    double bin; /* m */
    /* Optical path of the first bin. */
    double first; /* m */
} trocar_a_scan_header;
TROCAR_ASSERT(sizeof(trocar_a_scan_header) == 56, "trocar_a_scan_header");
TROCAR_ASSERT(offsetof(trocar_a_scan_header, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_a_scan_header, index) == 8, "index");
TROCAR_ASSERT(offsetof(trocar_a_scan_header, lines) == 16, "lines");
TROCAR_ASSERT(offsetof(trocar_a_scan_header, samples) == 20, "samples");
TROCAR_ASSERT(offsetof(trocar_a_scan_header, format) == 24, "format");
TROCAR_ASSERT(offsetof(trocar_a_scan_header, reserved) == 28, "reserved");
TROCAR_ASSERT(offsetof(trocar_a_scan_header, line_period) == 32, "line_period");
TROCAR_ASSERT(offsetof(trocar_a_scan_header, bin) == 40, "bin");
TROCAR_ASSERT(offsetof(trocar_a_scan_header, first) == 48, "first");
/* The manifest needs TROCAR_TYPE_SAMPLE_FORMAT beside it. */
#define TROCAR_TYPE_A_SCAN_HEADER \
    "{\"name\":\"AScanHeader\",\"doc\":\"Header of a frame of A-scans: `lines` depth profiles one after " \
    "the other, each of `samples` bins, in dB\\nfor `F32`.\",\"size\":56,\"align\":8," \
    "\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\",\"doc\":\"That of the spectra it was made " \
    "of.\"},{\"name\":\"index\",\"at\":8,\"type\":\"u64\",\"doc\":\"That of the spectra it was made of.\"}," \
    "{\"name\":\"lines\",\"at\":16,\"type\":\"u32\",\"doc\":\"Depth profiles in this frame.\"}," \
    "{\"name\":\"samples\",\"at\":20,\"type\":\"u32\",\"unit\":\"px\",\"doc\":\"Bins of one profile.\"}," \
    "{\"name\":\"format\",\"at\":24,\"type\":{\"ref\":\"SampleFormat\"}},{\"name\":\"reserved\",\"at\":28," \
    "\"type\":\"u32\"},{\"name\":\"line_period\",\"at\":32,\"type\":\"f64\",\"unit\":\"s\",\"doc\":\"From " \
    "one line to the next.\"},{\"name\":\"bin\",\"at\":40,\"type\":\"f64\",\"unit\":\"m\"," \
    "\"doc\":\"Optical path from one bin to the next: depth times index of refraction.\"}," \
    "{\"name\":\"first\",\"at\":48,\"type\":\"f64\",\"unit\":\"m\",\"doc\":\"Optical path of the first " \
    "bin.\"}]}"

/* A spectrometer (`spectrometer`): which light falls on which pixel. Wavelength of pixel i of n, with x =
 * 2 i / (n - 1) - 1, is the sum of `wavelength[k]` times x to the power k. */
typedef struct trocar_spectrometer {
    /* Pixels of one line. */
    uint32_t samples; /* px */
    /* Bits of a value that the detector fills. */
    uint32_t bits;
    /* Polynomial over the line, x from -1 to 1. */
    double wavelength[4]; /* m */
    double line_rate; /* Hz */
    double exposure; /* s */
} trocar_spectrometer;
TROCAR_ASSERT(sizeof(trocar_spectrometer) == 56, "trocar_spectrometer");
TROCAR_ASSERT(offsetof(trocar_spectrometer, samples) == 0, "samples");
TROCAR_ASSERT(offsetof(trocar_spectrometer, bits) == 4, "bits");
TROCAR_ASSERT(offsetof(trocar_spectrometer, wavelength) == 8, "wavelength");
TROCAR_ASSERT(offsetof(trocar_spectrometer, line_rate) == 40, "line_rate");
TROCAR_ASSERT(offsetof(trocar_spectrometer, exposure) == 48, "exposure");
#define TROCAR_TYPE_SPECTROMETER \
    "{\"name\":\"Spectrometer\",\"doc\":\"A spectrometer (`spectrometer`): which light falls on which " \
    "pixel. Wavelength of pixel i of n, with\\nx = 2 i / (n - 1) - 1, is the sum of `wavelength[k]` times " \
    "x to the power k.\",\"size\":56,\"align\":8,\"fields\":[{\"name\":\"samples\",\"at\":0," \
    "\"type\":\"u32\",\"unit\":\"px\",\"doc\":\"Pixels of one line.\"},{\"name\":\"bits\",\"at\":4," \
    "\"type\":\"u32\",\"doc\":\"Bits of a value that the detector fills.\"},{\"name\":\"wavelength\"," \
    "\"at\":8,\"type\":{\"array\":\"f64\",\"n\":4},\"unit\":\"m\",\"doc\":\"Polynomial over the line, x " \
    "from -1 to 1.\"},{\"name\":\"line_rate\",\"at\":40,\"type\":\"f64\",\"unit\":\"Hz\"}," \
    "{\"name\":\"exposure\",\"at\":48,\"type\":\"f64\",\"unit\":\"s\"}]}"

/* A distance from the tip of a tool to a surface, along the tool. */
typedef struct trocar_distance {
    /* When it was so: the middle of the exposure. */
    trocar_stamp stamp;
    double distance; /* m */
    /* Velocity of the surface along the tool against the base, away from the tip positive; NaN: not known. */
    double velocity; /* m/s */
    /* Standard deviation of `distance`. */
    double sigma; /* m */
    /* The surface's echo above the noise, dB; 0 without one. */
    double snr_db;
    /* False: there was no surface to be seen, and the rest is at best a prediction. */
    uint8_t valid;
    uint8_t reserved[7];
} trocar_distance;
TROCAR_ASSERT(sizeof(trocar_distance) == 48, "trocar_distance");
TROCAR_ASSERT(offsetof(trocar_distance, stamp) == 0, "stamp");
TROCAR_ASSERT(offsetof(trocar_distance, distance) == 8, "distance");
TROCAR_ASSERT(offsetof(trocar_distance, velocity) == 16, "velocity");
TROCAR_ASSERT(offsetof(trocar_distance, sigma) == 24, "sigma");
TROCAR_ASSERT(offsetof(trocar_distance, snr_db) == 32, "snr_db");
TROCAR_ASSERT(offsetof(trocar_distance, valid) == 40, "valid");
TROCAR_ASSERT(offsetof(trocar_distance, reserved) == 41, "reserved");
#define TROCAR_TYPE_DISTANCE \
    "{\"name\":\"Distance\",\"doc\":\"A distance from the tip of a tool to a surface, along the tool.\"," \
    "\"size\":48,\"align\":8,\"fields\":[{\"name\":\"stamp\",\"at\":0,\"type\":\"stamp\",\"doc\":\"When it " \
    "was so: the middle of the exposure.\"},{\"name\":\"distance\",\"at\":8,\"type\":\"f64\"," \
    "\"unit\":\"m\"},{\"name\":\"velocity\",\"at\":16,\"type\":\"f64\",\"unit\":\"m/s\",\"doc\":\"Velocity " \
    "of the surface along the tool against the base, away from the tip positive; NaN: not known.\"}," \
    "{\"name\":\"sigma\",\"at\":24,\"type\":\"f64\",\"unit\":\"m\",\"doc\":\"Standard deviation of " \
    "`distance`.\"},{\"name\":\"snr_db\",\"at\":32,\"type\":\"f64\",\"doc\":\"The surface's echo above the " \
    "noise, dB; 0 without one.\"},{\"name\":\"valid\",\"at\":40,\"type\":\"bool\",\"doc\":\"False: there " \
    "was no surface to be seen, and the rest is at best a prediction.\"},{\"name\":\"reserved\",\"at\":41," \
    "\"type\":{\"array\":\"u8\",\"n\":7}}]}"

#ifdef __cplusplus
namespace trocar {
namespace data {
using Scalar = ::trocar_scalar;
using Message = ::trocar_message;
using Pose = ::trocar_pose;
using Twist = ::trocar_twist;
using Wrench = ::trocar_wrench;
using CartesianState = ::trocar_cartesian_state;
using Transform = ::trocar_transform;
using JointState = ::trocar_joint_state;
using JointKind = ::trocar_joint_kind;
using JointConfiguration = ::trocar_joint_configuration;
using ArmState = ::trocar_arm_state;
using OperatingMode = ::trocar_operating_mode;
using OperatingState = ::trocar_operating_state;
using FixtureKind = ::trocar_fixture_kind;
using VirtualFixture = ::trocar_virtual_fixture;
using Retreat = ::trocar_retreat;
using ToolStatus = ::trocar_tool_status;
using ToolPose = ::trocar_tool_pose;
using TrackedTools = ::trocar_tracked_tools;
using ForceRange = ::trocar_force_range;
using InputState = ::trocar_input_state;
using InputLayout = ::trocar_input_layout;
using ButtonEvent = ::trocar_button_event;
using PixelFormat = ::trocar_pixel_format;
using ImageHeader = ::trocar_image_header;
using StereoHeader = ::trocar_stereo_header;
using CameraGeometry = ::trocar_camera_geometry;
using SampleFormat = ::trocar_sample_format;
using SpectraHeader = ::trocar_spectra_header;
using AScanHeader = ::trocar_a_scan_header;
using Spectrometer = ::trocar_spectrometer;
using Distance = ::trocar_distance;
} // namespace data
} // namespace trocar
#endif

#endif
