// Lights of the studio, and the soft shadow where a subject meets the floor.
import * as THREE from "three";

const SIDE = 128;
/** Width of the floor that the shadow map sees, in sizes of the subject. */
const REACH = 2.2;
/** Height above the floor at which a subject stops to darken it. */
const HEIGHT = 0.42;

/** A warm key light from the front left, a cool rim light from behind, and light from all around. */
export function addLights(scene) {
  scene.add(new THREE.HemisphereLight(0xf4f7ff, 0xd8cbbb, 1.75));
  const key = new THREE.DirectionalLight(0xfff3e4, 2.15);
  const rim = new THREE.DirectionalLight(0xe8f1ff, 0.9);
  key.position.set(-1.1, 1.6, 1.5);
  rim.position.set(1.2, 0.9, -1.4);
  scene.add(key, rim);
}

const heightShader = {
  vertexShader: `varying float height; uniform float floorY;
    void main() { vec4 p = modelMatrix * vec4(position, 1.0); height = p.y - floorY;
      gl_PointSize = 4.0; gl_Position = projectionMatrix * viewMatrix * p; }`,
  fragmentShader: `varying float height; uniform float reach;
    void main() { float near = clamp(1.0 - height / reach, 0.0, 1.0); gl_FragColor = vec4(near * near); }`,
};

const screenVertex = "varying vec2 at; void main() { at = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }";
const blurFragment = `varying vec2 at; uniform sampler2D map; uniform vec2 along;
  void main() { float sum = 0.0, weight = 0.0;
    for (int k = -5; k <= 5; k++) { float w = exp(-0.11 * float(k * k)); sum += w * texture2D(map, at + along * float(k)).r; weight += w; }
    gl_FragColor = vec4(sum / weight); }`;
// Seen from below, left and right change places: hence 1 - x.
const floorFragment = `varying vec2 at; uniform sampler2D map; uniform vec3 color; uniform float strength;
  void main() { float edge = smoothstep(0.5, 0.36, distance(at, vec2(0.5)));
    gl_FragColor = vec4(color, strength * edge * texture2D(map, vec2(1.0 - at.x, at.y)).r); }`;

/** Draws how near a subject is to the floor from below, blurs that, and lays it on the floor. One a panel. */
export class ContactShadow {
  constructor(scene) {
    this.camera = new THREE.OrthographicCamera(-REACH / 2, REACH / 2, REACH / 2, -REACH / 2, 0, 4);
    this.targets = [0, 1].map(() => new THREE.WebGLRenderTarget(SIDE, SIDE, { depthBuffer: true }));
    this.height = new THREE.ShaderMaterial({
      ...heightShader, side: THREE.DoubleSide, uniforms: { floorY: { value: 0 }, reach: { value: HEIGHT } },
    });
    this.blur = new THREE.ShaderMaterial({
      vertexShader: screenVertex, fragmentShader: blurFragment, depthTest: false,
      uniforms: { map: { value: null }, along: { value: new THREE.Vector2() } },
    });
    this.screen = new THREE.Scene();
    const sheet = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), this.blur);
    sheet.frustumCulled = false;
    this.screen.add(sheet);
    this.floor = this.makeFloor();
    scene.add(this.floor);
  }

  makeFloor() {
    const material = new THREE.ShaderMaterial({
      vertexShader: "varying vec2 at; void main() { at = uv; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }",
      fragmentShader: floorFragment, transparent: true, depthWrite: false,
      uniforms: { map: { value: this.targets[0].texture }, color: { value: new THREE.Color(0) }, strength: { value: 0.62 } },
    });
    const floor = new THREE.Mesh(new THREE.PlaneGeometry(REACH, REACH).rotateX(-Math.PI / 2), material);
    floor.renderOrder = -1;
    return floor;
  }

  /** Make the shadow of a subject at a height of the floor, about a middle (x, z), and lay it there. */
  cast(renderer, scene, body, floorY, x, z) {
    this.camera.position.set(x, floorY - 0.02, z);
    this.camera.up.set(0, 0, -1);
    this.camera.lookAt(x, floorY + 1, z);
    this.height.uniforms.floorY.value = floorY;
    this.floor.visible = false;
    const worn = body.material;
    body.material = this.height;
    this.draw(renderer, scene, this.camera, this.targets[0]);
    body.material = worn;
    this.sweep(renderer, 0, 1, 1 / SIDE, 0);
    this.sweep(renderer, 1, 0, 0, 1 / SIDE);
    renderer.setRenderTarget(null);
    this.floor.position.set(x, floorY, z);
    this.floor.visible = true;
  }

  sweep(renderer, from, to, x, y) {
    this.blur.uniforms.map.value = this.targets[from].texture;
    this.blur.uniforms.along.value.set(x, y);
    this.draw(renderer, this.screen, this.camera, this.targets[to]);
  }

  draw(renderer, scene, camera, target) {
    renderer.setRenderTarget(target);
    renderer.clear();
    renderer.render(scene, camera);
  }

  setTheme(dark) {
    this.floor.material.uniforms.strength.value = dark ? 0.85 : 0.6;
    this.floor.material.uniforms.color.value.set(dark ? 0x000000 : 0x3a2f26);
  }

  dispose() {
    for (const target of this.targets) target.dispose();
    for (const material of [this.height, this.blur, this.floor.material]) material.dispose();
  }
}
