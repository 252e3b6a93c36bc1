// The programs of the graphics card. Colours are computed from where a point lies on the head at rest, so that brows,
// lips and irises have sharp edges at any size.

export const KIND = { skin: 0, eye: 1, teeth: 2, tongue: 3, ear: 4, neck: 5, cavity: 6 };

export const VERTEX = `#version 300 es
in vec3 aPosition;
in vec3 aNormal;
in vec3 aRest;
in vec4 aTint;
uniform mat4 uHead;
uniform mat4 uPart;
uniform mat4 uCamera;
uniform int uKind;
out vec3 vAt;
out vec3 vNormal;
out vec3 vRest;
out vec4 vTint;
out float vHeight;

void main() {
  vec4 part = uPart * vec4(aPosition, 1.0);
  vec3 at = (uHead * part).xyz;
  vec3 normal = mat3(uHead) * mat3(uPart) * aNormal;
  if (uKind == ${KIND.neck}) {
    float follow = smoothstep(-150.0, -70.0, aPosition.y);
    at = mix(part.xyz, at, follow);
    normal = mix(aNormal, normal, follow);
  }
  vAt = at;
  vNormal = normal;
  vRest = aRest;
  vTint = aTint;
  vHeight = part.y;
  gl_Position = uCamera * vec4(at, 1.0);
}`;

export const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
in vec3 vAt;
in vec3 vNormal;
in vec3 vRest;
in vec4 vTint;
in float vHeight;
uniform int uKind;
uniform vec3 uEye;
uniform float uLid;
uniform float uGreyness;
out vec4 colour;

const vec3 SKIN = vec3(0.78, 0.47, 0.34);
const vec3 LIP = vec3(0.60, 0.19, 0.17);
const vec3 HAIR = vec3(0.045, 0.028, 0.024);
const vec3 INSIDE = vec3(0.035, 0.008, 0.008);
const vec3 IRIS = vec3(0.03, 0.20, 0.25);

float browShape(vec2 at) {
  float side = abs(at.x);
  float nearest = clamp(side, 15.5, 52.0);
  float part = (nearest - 15.5) / 36.5;
  float line = 22.0 + 4.0 * sin(part * 2.7) - 2.0 * part;
  float half_ = mix(2.7, 1.0, part * part);
  return 1.0 - smoothstep(half_ - 0.8, half_ + 0.8, length(vec2(side - nearest, at.y - line)));
}

// Around the line between the lips, as form.js draws it; the upper lip has a bow.
float lipShape(vec2 at) {
  float side = abs(at.x);
  float along = side / 26.5;
  if (along >= 1.0) return 0.0;
  float line = -68.0 + 2.8 * min(1.6, side * side / 625.0) - 0.6 * exp(-at.x * at.x / 36.0);
  float full = pow(1.0 - along * along, 0.62);
  float bow = 1.0 - 0.28 * exp(-at.x * at.x / 10.0) + 0.1 * exp(-(side - 7.0) * (side - 7.0) / 25.0);
  float above = at.y - line;
  float edge = above > 0.0 ? 7.6 * full * bow : 9.4 * full;
  return 1.0 - smoothstep(edge - 0.6, edge + 0.6, abs(above));
}

// As in head.js, which lifts the surface there.
float hairShape(vec3 at) {
  float side = abs(at.x);
  float line = 66.0 - 16.0 * smoothstep(30.0, 62.0, side) + 3.0 * exp(-(side - 26.0) * (side - 26.0) / 196.0);
  float front = smoothstep(line - 0.8, line + 1.2, at.y);
  float behind = (1.0 - smoothstep(-16.0, -13.0, at.z)) * smoothstep(-60.0, -57.0, at.y);
  float temples = smoothstep(60.0, 63.0, side) * (1.0 - smoothstep(18.0, 22.0, at.z)) * smoothstep(-11.0, -7.0, at.y);
  return max(front, max(behind, temples));
}

vec3 skinColour() {
  vec2 at = vRest.xy;
  vec3 base = SKIN;
  float front = step(0.0, vRest.z);
  float blush = exp(-dot((vec2(abs(at.x), at.y) - vec2(40.0, -36.0)) / 19.0, (vec2(abs(at.x), at.y) - vec2(40.0, -36.0)) / 19.0));
  blush += 0.7 * exp(-dot((at - vec2(0.0, -41.0)) / vec2(15.0, 11.0), (at - vec2(0.0, -41.0)) / vec2(15.0, 11.0)));
  base = mix(base, vec3(0.80, 0.33, 0.25), 0.42 * blush * front);
  vec2 nostril = (vec2(abs(at.x), at.y) - vec2(6.2, -51.2)) / vec2(3.6, 1.9);
  base *= 1.0 - 0.75 * front * exp(-dot(nostril, nostril));
  base = mix(base, LIP, lipShape(at) * front);
  base = mix(base, HAIR, 0.93 * browShape(at) * front);
  base = mix(base, HAIR, hairShape(vRest));
  base = mix(base, HAIR, clamp(vTint.y, 0.0, 1.0));
  return base * (1.0 - 0.8 * vTint.w);
}

// Iris and pupil lie around the z axis of the eyeball.
vec3 eyeColour(out float wet) {
  vec3 d = normalize(vRest);
  float r = length(d.xy) * 15.6;
  float around = atan(d.y, d.x);
  vec3 white = vec3(0.84, 0.83, 0.81) - 0.10 * smoothstep(7.0, 16.0, r) * vec3(0.3, 1.0, 1.0);
  float fibres = 0.5 + 0.5 * sin(around * 37.0 + 3.0 * sin(around * 11.0));
  vec3 iris = IRIS * (0.8 + 0.5 * fibres * smoothstep(3.0, 6.0, r)) + vec3(0.10, 0.12, 0.05) * smoothstep(6.0, 3.2, r);
  iris *= 1.0 - 0.75 * smoothstep(6.6, 8.0, r);
  iris += 0.10 * IRIS * smoothstep(0.0, -6.0, d.y * 16.0);
  vec3 c = mix(iris, white, smoothstep(7.6, 8.3, r));
  c = mix(vec3(0.004), c, smoothstep(3.1, 3.7, r));
  wet = d.z > 0.0 ? 1.0 : 0.0;
  return c;
}

vec3 light(vec3 base, vec3 n, vec3 toEye, float gloss, float sharpness, float soft) {
  vec3 key = normalize(vec3(-0.45, 0.62, 0.75));
  vec3 fill = normalize(vec3(0.85, 0.05, 0.5));
  float k = (dot(n, key) + soft) / (1.0 + soft);
  vec3 warm = pow(vec3(max(k, 0.0)), mix(vec3(1.0), vec3(0.85, 1.1, 1.2), soft));
  vec3 sum = base * (warm * vec3(1.0, 0.95, 0.88) * 1.0);
  sum += base * max((dot(n, fill) + 0.3) / 1.3, 0.0) * vec3(0.30, 0.34, 0.42);
  sum += base * mix(vec3(0.16, 0.12, 0.11), vec3(0.30, 0.32, 0.36), n.y * 0.5 + 0.5);
  float rim = pow(1.0 - max(dot(n, toEye), 0.0), 3.0);
  sum += rim * 0.18 * vec3(0.55, 0.7, 1.0) * (0.4 + 0.6 * max(n.y + 0.3, 0.0));
  vec3 h = normalize(key + toEye);
  sum += gloss * pow(max(dot(n, h), 0.0), sharpness);
  return sum;
}

void main() {
  vec3 n = normalize(vNormal);
  vec3 toEye = normalize(uEye - vAt);
  bool isFront = gl_FrontFacing;
  vec3 sum;
  if (uKind == ${KIND.cavity}) {
    colour = vec4(pow(INSIDE, vec3(1.0 / 2.2)), 1.0);
    return;
  }
  if (uKind == ${KIND.skin}) {
    float hair = hairShape(vRest);
    float lip = lipShape(vRest.xy) * step(0.0, vRest.z);
    sum = light(skinColour(), n, toEye, mix(0.09, 0.28, lip) * (1.0 - vTint.w), mix(16.0, 42.0, lip), mix(0.42, 0.15, hair));
  } else if (uKind == ${KIND.eye}) {
    float wet;
    vec3 base = eyeColour(wet);
    float shadow = mix(0.42, 1.0, smoothstep(uLid + 0.5, uLid - 5.5, vHeight));
    sum = light(base * shadow, n, toEye, 0.0, 1.0, 0.6);
    vec3 h = normalize(normalize(vec3(-0.4, 0.62, 0.8)) + toEye);
    sum += wet * (0.9 * smoothstep(0.982, 0.990, dot(n, h)));
    vec3 low = normalize(normalize(vec3(0.5, -0.35, 0.8)) + toEye);
    sum += wet * 0.12 * smoothstep(0.975, 0.995, dot(n, low));
  } else if (uKind == ${KIND.teeth}) {
    vec3 base = mix(vec3(0.80, 0.76, 0.68), vec3(0.55, 0.17, 0.16), vTint.x) * mix(0.62, 1.0, smoothstep(0.0, 0.35, vTint.y));
    sum = 0.75 * light(base, isFront ? n : -n, toEye, 0.15, 40.0, 0.5) * smoothstep(48.0, 72.0, vRest.z);
  } else if (uKind == ${KIND.tongue}) {
    sum = 0.85 * light(vec3(0.62, 0.19, 0.19), n, toEye, 0.12, 24.0, 0.4) * smoothstep(34.0, 70.0, vRest.z + 10.0);
  } else if (uKind == ${KIND.ear}) {
    sum = light(SKIN * (1.0 - 0.8 * vTint.w), isFront ? n : -n, toEye, 0.05, 14.0, 0.5);
  } else {
    // Its upper end is inside the head, and must not be seen through the mouth.
    if (vRest.y > -98.0 && vRest.z > -12.0 && abs(vRest.x) < 36.0) discard;
    vec3 shirt = vec3(0.05, 0.22, 0.30);
    float collar = smoothstep(-148.0, -150.0, vRest.y + 0.0016 * vRest.x * vRest.x - 8.0 * exp(-vRest.x * vRest.x / 900.0) + 10.0);
    vec3 base = mix(SKIN * (1.0 - vTint.w), shirt, collar);
    sum = light(base, n, toEye, 0.03, 10.0, 0.4);
  }
  float alpha = uKind == ${KIND.neck} ? smoothstep(-226.0, -170.0, vRest.y) : 1.0;
  sum = mix(sum, vec3(dot(sum, vec3(0.3, 0.55, 0.15))) * vec3(0.95, 1.0, 1.06), uGreyness);
  sum = sum / (1.0 + 0.22 * sum);
  colour = vec4(pow(max(sum, 0.0), vec3(1.0 / 2.2)) * alpha, alpha);
}`;
