// Lights of the stage, and the soft contact shadow of a subject on the floor.
import * as THREE from "three";

/** Side of the shadow map in texels. */
const SIDE = 128;
/** Side of the square of floor that the shadow map covers; 1 is the size of the subject. */
const REACH = 2.2;
/** Height above the floor, in the same unit, at which a subject casts no contact shadow. */
const HEIGHT = 0.42;

/** Add a warm key light from the front left, a cool rim light from behind, and ambient light. */
export function addLights(scene) {
  scene.add(new THREE.HemisphereLight(0xf4f7ff, 0xd8cbbb, 1.75));
  const key = new THREE.DirectionalLight(0xfff3e4, 2.15);
  const rim = new THREE.DirectionalLight(0xe8f1ff, 0.9);
  key.position.set(-1.1, 1.6, 1.5);
  rim.position.set(1.2, 0.9, -1.4);
  scene.add(key, rim);
}

/** Draws the nearness of a surface to the floor: 1 at the floor, 0 at HEIGHT. */
const heightShader = {
  vertexShader: `varying float height; uniform float floorY;
    void main() { vec4 p = modelMatrix * vec4(position, 1.0); height = p.y - floorY;
      gl_PointSize = 4.0; gl_Position = projectionMatrix * viewMatrix * p; }`,
  fragmentShader: `varying float height; uniform float reach;
    void main() { float near = clamp(1.0 - height / reach, 0.0, 1.0); gl_FragColor = vec4(near * near); }`,
};

const screenVertex = "varying vec2 at; void main() { at = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }";
/** A Gaussian blur of 11 texels along one axis; two passes, x and y, cost 22 lookups where one pass in 2D takes 121. */
const blurFragment = `varying vec2 at; uniform sampler2D map; uniform vec2 along;
  void main() { float sum = 0.0, weight = 0.0;
    for (int k = -5; k <= 5; k++) { float w = exp(-0.11 * float(k * k)); sum += w * texture2D(map, at + along * float(k)).r; weight += w; }
    gl_FragColor = vec4(sum / weight); }`;
// The shadow map is drawn from below, where left and right are mirrored: hence 1 - x.
const floorFragment = `varying vec2 at; uniform sampler2D map; uniform vec3 color; uniform float strength;
  void main() { float edge = smoothstep(0.5, 0.36, distance(at, vec2(0.5)));
    gl_FragColor = vec4(color, strength * edge * texture2D(map, vec2(1.0 - at.x, at.y)).r); }`;

/** The contact shadow of one panel: nearness to the floor, drawn from below, blurred, and shown on the floor. */
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

  /** Draw the shadow of a subject on the floor at height `floorY`, in a square centred at (x, z). */
  cast(renderer, scene, body, floorY, x, z) {
    this.camera.position.set(x, floorY - 0.02, z);
    this.camera.up.set(0, 0, -1);
    this.camera.lookAt(x, floorY + 1, z);
    this.height.uniforms.floorY.value = floorY;
    this.floor.visible = false;
    const material = body.material;
    body.material = this.height;
    this.draw(renderer, scene, this.camera, this.targets[0]);
    body.material = material;
    this.blurPass(renderer, 0, 1, 1 / SIDE, 0);
    this.blurPass(renderer, 1, 0, 0, 1 / SIDE);
    renderer.setRenderTarget(null);
    this.floor.position.set(x, floorY, z);
    this.floor.visible = true;
  }

  blurPass(renderer, from, to, x, y) {
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
