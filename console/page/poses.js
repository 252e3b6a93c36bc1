// The takes of a calibration as facewire names them: what the wearer is asked to do, the coefficients that the head beside
// it shows, and why a take waits or is refused.

export const TAKES = {
  "neutral": ["Look into the camera with your face at rest and your mouth closed.", []],
  "eyes-shut": ["Shut both eyes, count to three, and open them again.", ["eyeBlinkLeft", "eyeBlinkRight"]],
  "jaw-open": ["Open your mouth wide.", ["jawOpen"]],
  "brows-up": ["Raise your eyebrows.", ["browInnerUp", "browOuterUpLeft", "browOuterUpRight"]],
  "brows-down": ["Draw your eyebrows down, as if in anger.", ["browDownLeft", "browDownRight"]],
  "smile": ["Smile as widely as you can.", ["mouthSmileLeft", "mouthSmileRight"]],
  "pucker": ["Pucker your lips, as if for a kiss.", ["mouthPucker"]],
  "look-left": ["Look to your left with your eyes alone.", ["eyeLookOutLeft", "eyeLookInRight"]],
  "look-right": ["Look to your right with your eyes alone.", ["eyeLookInLeft", "eyeLookOutRight"]],
  "look-up": ["Look up with your eyes alone.", ["eyeLookUpLeft", "eyeLookUpRight"]],
  "look-down": ["Look down with your eyes alone.", ["eyeLookDownLeft", "eyeLookDownRight"]],
};

export const REFUSALS = {
  "no-picture": "No picture comes from the camera: check its cable.",
  "no-face": "No face is in the picture: sit in front of the camera.",
  "too-dark": "The face is too dark: turn on a light in front of you.",
  "head-turned": "The head is turned: face the camera.",
  "head-moves": "The head moves: keep it still.",
  "face-moves": "The face moves: hold it still.",
  "eyes-shut": "The eyes are shut or half shut: open them as you usually do.",
  "smiling": "The mouth smiles: let your face rest.",
  "mouth-open": "The mouth is open: close it.",
  "brows-moved": "The eyebrows are raised or drawn down: let your face rest.",
  "not-seen": "No such movement is seen: make it stronger.",
  "too-short": "The movement ended too early: hold it a little longer.",
};
