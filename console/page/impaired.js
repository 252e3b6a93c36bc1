// What makes tracking poor, as the service names it, with the remedy.

export const SENTENCES = {
  "black": "The picture is black: open the shutter of the camera, take the cap off its lens, or switch on a light.",
  "dark": "The picture is dark or noisy: light the face from the front.",
  "backlight": "The face is much darker than what is behind it: turn away from the window, or light the face from the front.",
  "small-face": "The face is small in the picture: move closer to the camera, or choose a larger picture.",
  "cut-off-face": "A part of the face is outside the picture: turn the camera, or move back.",
  "doubtful-face": "The face is hardly recognised or lies on its side: uncover it and look at the camera. If the camera is mounted on its side or upside down, turn its picture in the settings.",
  "turned-away": "The face is turned away: look towards the camera, or place the camera where the wearer looks.",
  "halved-rate": "The camera delivers about half its frame rate or less, as many do to expose longer: add light.",
  "missing-frames": "Frames get lost between camera and board: use a USB port of its own and a short cable, or choose a smaller picture.",
  "frozen-picture": "The picture does not change at all: open the shutter of the camera, add light, or unplug it and plug it in again. If a program sends the picture, restart that program.",
  "undervoltage": "The supply voltage is too low, so that the board slows down: use a stronger power supply and a short cable.",
  "hot": "The board is so hot that it slows down: add a heat sink or a fan, or let air reach it.",
  "slow-governor": "A processor saves power and so runs slower than it could: set its governor to schedutil.",
};

// The labels of a metric that are present: facewire_impaired{by="dark"} 1.
export function present(metrics, name) {
  const samples = Object.entries(metrics ?? {}).filter(([key, value]) => key.startsWith(`${name}{`) && value > 0);
  return samples.map(([key]) => /="([^"]*)"/.exec(key)?.[1] ?? key);
}

export const impairments = (status) => present(status?.service?.metrics, "facewire_impaired").map((name) => SENTENCES[name] ?? name);
