"""Joint names of common rigs and motion databases."""

from __future__ import annotations

from collections.abc import Callable

CENTRE = ["Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head"]
SIDE = ["Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase"]
TABLE = """
cmu: {}, Left{}, Right{}; Hips LowerBack Spine Spine1 Neck Neck1 Head
  Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase
mixamo: mixamorig:{}, mixamorig:Left{}, mixamorig:Right{}; Hips Spine Spine1 Spine2 Neck - Head
  Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase
xsens: {}, Left{}, Right{}; Pelvis L5 T12 T8 Neck - Head
  Shoulder UpperArm ForeArm Hand UpperLeg LowerLeg Foot Toe
mvn-bvh: {}, Left{}, Right{}; Hips Chest Chest2 Chest4 Neck - Head
  Collar Shoulder Elbow Wrist Hip Knee Ankle Toe
biped: Bip01 {}, Bip01 L {}, Bip01 R {}; Pelvis Spine Spine1 Spine2 Neck - Head
  Clavicle UpperArm Forearm Hand Thigh Calf Foot Toe0
rigify: {}, {}.L, {}.R; spine spine.001 spine.002 spine.003 spine.004 spine.005 spine.006
  shoulder upper_arm forearm hand thigh shin foot toe
vroid: J_Bip_C_{}, J_Bip_L_{}, J_Bip_R_{}; Hips Spine Chest UpperChest Neck - Head
  Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot ToeBase
lafan1: {}, Left{}, Right{}; Hips Spine Spine1 Spine2 Neck - Head
  Shoulder Arm ForeArm Hand UpLeg Leg Foot Toe
bandai: {}, {}_L, {}_R; Hips - Spine Chest Neck - Head
  Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot Toes
accad: {}, Left{}, Right{}; Hips ToSpine Spine Spine1 Neck - Head
  Collar Shoulder Elbow Wrist Hip Knee Ankle Toe
acclaim: {}, l{}, r{}; root lowerback upperback thorax lowerneck upperneck head
  clavicle humerus radius wrist femur tibia foot toes
smpl: {}, left_{}, right_{}; pelvis spine1 spine2 spine3 neck - head
  collar shoulder elbow wrist hip knee ankle foot
humanml: {}, L_{}, R_{}; Pelvis Spine1 Spine2 Spine3 Neck - Head
  Collar Shoulder Elbow Wrist Hip Knee Ankle Foot
quaternius: {}, {}.L, {}.R; Hips Abdomen Torso Chest Neck - Head
  Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot -
kaykit: {}, {}.l, {}.r; hips - spine chest - - head
  - upperarm lowerarm wrist upperleg lowerleg foot toes
unreal: {}, {}_l, {}_r; pelvis spine_01 spine_02 spine_03 neck_01 - head
  clavicle upperarm lowerarm hand thigh calf foot ball
vrm: {}, left{}, right{}; hips - spine chest neck - head
  Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot Toes
godot: {}, Left{}, Right{}; Hips Spine Chest UpperChest Neck - Head
  Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot Toes
rigify-def: DEF-{}, DEF-{}.L, DEF-{}.R; spine spine.001 spine.002 spine.003 spine.004 spine.005 spine.006
  shoulder upper_arm forearm hand thigh shin foot toe
blender: {}, {}.L, {}.R; Hips - Spine Chest Neck - Head
  Shoulder Arm ForeArm Hand UpLeg Leg Foot Toe
mmd: {}, 左{}, 右{}; 下半身 - 上半身 上半身2 首 - 頭
  肩 腕 ひじ 手首 足 ひざ 足首 つま先
mmd-tools: {}, {}.L, {}.R; 下半身 - 上半身 上半身2 首 - 頭
  肩 腕 ひじ 手首 足 ひざ 足首 つま先
synty: {}, {}_L, {}_R; Hips Spine_01 Spine_02 Spine_03 Neck - Head
  Clavicle Shoulder Elbow Hand UpperLeg LowerLeg Ankle Ball
genesis9: {}, l_{}, r_{}; hip spine1 spine2 spine3 neck1 neck2 head
  shoulder upperarm forearm hand thigh shin foot toes
genesis2: {}, l{}, r{}; hip abdomen abdomen2 chest neck - head
  Collar Shldr ForeArm Hand Thigh Shin Foot Toe
auto-rig-pro: {}.x, {}.l, {}.r; root spine_01 spine_02 spine_03 neck - head
  shoulder arm_stretch forearm_stretch hand thigh_stretch leg_stretch foot toes_01
advanced-skeleton: {}_M, {}_L, {}_R; Root Spine1 Spine2 Chest Neck - Head
  Scapula Shoulder Elbow Wrist Hip Knee Ankle Toes
optitrack: {}, L{}, R{}; Hip - Ab Chest Neck - Head
  Shoulder UArm FArm Hand Thigh Shin Foot Toe
theia: {}, l_{}, r_{}; pelvis - abdomen thorax neck - head
  clavicle uarm larm hand thigh shank foot toes
valve: ValveBiped.Bip01_{}, ValveBiped.Bip01_L_{}, ValveBiped.Bip01_R_{}; Pelvis Spine Spine1 Spine4 Neck1 - Head1
  Clavicle UpperArm Forearm Hand Thigh Calf Foot Toe0
segments: {}, L{}, R{}; pelvis - spine thorax neck - head
  clavicle humerus ulna hand thigh shank foot toes
daz: {}, l{}, r{}; hip abdomenLower abdomenUpper chestLower neckLower neckUpper head
  Collar ShldrBend ForearmBend Hand ThighBend Shin Foot Toe
"""
"""For each scheme, templates of names for the centre, the left and the right, and names for `CENTRE` (- for none); then
names for `SIDE`."""


def _read_table() -> dict[str, tuple[str, ...]]:
    lines = TABLE.strip().splitlines()
    heads = (line.replace("; ", ": ").split(": ") for line in lines[::2])
    rows = zip(heads, lines[1::2], strict=True)
    return {name: (*templates.split(", "), centre, side.strip()) for (name, templates, centre), side in rows}


SCHEMES = _read_table()


def spelt(scheme: str) -> dict[str, str]:
    """Map our joints to the names of a scheme."""
    centre, left, right, middle, side = SCHEMES[scheme]
    rows = [("{}", CENTRE, centre, middle), ("Left{}", SIDE, left, side), ("Right{}", SIDE, right, side)]
    return {
        ours.format(joint): template.format(name)
        for ours, joints, template, names in rows
        for joint, name in zip(joints, names.split(), strict=True)
        if name != "-"
    }


def renamed(scheme: str) -> Callable[[str], str]:
    """Return the function from our joint names to those of a scheme; joints that it lacks get names without meaning."""
    names = spelt(scheme)
    return lambda joint: names.get(joint, f"twist{joint}")
