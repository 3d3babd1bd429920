// The geometry of a map: longitude and latitude to pixels and back, the view that contains its points, the length of the
// scale bar and the lines of the grid. It draws nothing.
//
// Equirectangular, true to scale along the points' middle latitude: x = longitude * cos(that latitude).

export const KM_PER_DEGREE = 111.195; // on a great circle of a sphere with radius 6371 km
const LEAST_SPAN_DEGREES = 0.02; // about two kilometres: points are rounded to a few hundred metres
const MOST_SPAN_DEGREES = 360;
const MARGIN = 0.12;
const STEPS = [1, 2, 5];
const GRID_DEGREES = [0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30];

// Orders longitudes so that the widest gap is outside: points on both sides of the 180th meridian are neighbours.
export function westernmost(longitudes) {
  const sorted = [...new Set(longitudes)].sort((one, other) => one - other);
  let [widest, start] = [sorted[0] + 360 - sorted.at(-1), sorted[0]];
  for (let n = 1; n < sorted.length; n += 1) {
    const gap = sorted[n] - sorted[n - 1];
    if (gap > widest) [widest, start] = [gap, sorted[n]];
  }
  return start;
}

export function eastOf(start, longitude) {
  return start + ((((longitude - start) % 360) + 360) % 360);
}

export class MapView {
  // points: [{latitude, longitude}], at least one
  constructor(points) {
    this.start = westernmost(points.map((point) => point.longitude));
    const longitudes = points.map((point) => eastOf(this.start, point.longitude));
    const latitudes = points.map((point) => point.latitude);
    this.bounds = {
      west: Math.min(...longitudes),
      east: Math.max(...longitudes),
      south: Math.min(...latitudes),
      north: Math.max(...latitudes),
    };
    this.squeeze = Math.max(Math.cos((((this.bounds.south + this.bounds.north) / 2) * Math.PI) / 180), 0.05);
    this.width = 600;
    this.height = 400;
    this.fit();
  }

  resize(width, height) {
    const wasFitted = this.isFitted;
    this.pixelsPerDegree *= width / this.width;
    [this.width, this.height] = [width, height];
    if (wasFitted) this.fit();
    else this.limit();
  }

  // all points, with a margin
  fit() {
    const { west, east, south, north } = this.bounds;
    const wide = Math.max((east - west) * this.squeeze, LEAST_SPAN_DEGREES) * (1 + 2 * MARGIN);
    const high = Math.max(north - south, LEAST_SPAN_DEGREES) * (1 + 2 * MARGIN);
    this.pixelsPerDegree = Math.min(this.width / wide, this.height / high);
    this.centre = { longitude: (west + east) / 2, latitude: (south + north) / 2 };
    this.limit();
    this.isFitted = true;
  }

  // zooms by a factor; the place at this pixel stays there
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const held = this.placeOf(x, y);
    this.pixelsPerDegree *= factor;
    this.limit();
    const [nowX, nowY] = this.pixelOf(held.longitude, held.latitude);
    this.pan(nowX - x, nowY - y);
  }

  // moves by pixels to the right and down
  pan(right, down) {
    this.centre.longitude += right / (this.pixelsPerDegree * this.squeeze);
    this.centre.latitude -= down / this.pixelsPerDegree;
    this.limit();
    this.isFitted = false;
  }

  limit() {
    const least = this.width / (MOST_SPAN_DEGREES * this.squeeze);
    const most = Math.max(this.width, this.height) / (LEAST_SPAN_DEGREES / 4);
    this.pixelsPerDegree = Math.min(Math.max(this.pixelsPerDegree, least), most);
    this.centre.latitude = Math.min(Math.max(this.centre.latitude, -90), 90);
    const middle = (this.bounds.west + this.bounds.east) / 2;
    this.centre.longitude = Math.min(Math.max(this.centre.longitude, middle - 180), middle + 180);
  }

  // longitude: counted from the westernmost point, or 360 more or less
  pixelOf(longitude, latitude) {
    return [
      this.width / 2 + (longitude - this.centre.longitude) * this.squeeze * this.pixelsPerDegree,
      this.height / 2 - (latitude - this.centre.latitude) * this.pixelsPerDegree,
    ];
  }

  pixelOfPoint(point) {
    return this.pixelOf(eastOf(this.start, point.longitude), point.latitude);
  }

  placeOf(x, y) {
    return {
      longitude: this.centre.longitude + (x - this.width / 2) / (this.pixelsPerDegree * this.squeeze),
      latitude: this.centre.latitude - (y - this.height / 2) / this.pixelsPerDegree,
    };
  }

  // the longest round distance within so many pixels: {km, pixels}; exact from north to south everywhere, from west to
  // east at the points' middle latitude
  scaleBar(mostPixels = 120) {
    const mostKm = (mostPixels / this.pixelsPerDegree) * KM_PER_DEGREE;
    const power = 10 ** Math.floor(Math.log10(mostKm));
    const km = power * STEPS.findLast((step) => step * power <= mostKm * (1 + 1e-9));
    return { km, pixels: (km / KM_PER_DEGREE) * this.pixelsPerDegree };
  }

  // where the grid's lines are: {step, longitudes, latitudes}, degrees
  grid(leastPixels = 90) {
    const step = GRID_DEGREES.find((each) => each * this.pixelsPerDegree * this.squeeze >= leastPixels) ?? 30;
    const [upper, lower] = [this.placeOf(0, 0), this.placeOf(this.width, this.height)];
    const between = (low, high) => {
      const found = [];
      for (let n = Math.ceil(low / step); n * step <= high; n += 1) found.push(n * step);
      return found;
    };
    return {
      step,
      longitudes: between(upper.longitude, lower.longitude),
      latitudes: between(Math.max(lower.latitude, -90), Math.min(upper.latitude, 90)),
    };
  }
}

export function degrees(value, step, [positive, negative]) {
  const digits = step >= 1 ? 0 : Math.ceil(-Math.log10(step) - 1e-9);
  const size = Math.abs(value).toFixed(digits);
  return `${size}°${Number(size) === 0 ? "" : value > 0 ? positive : negative}`;
}

export function around(longitude) {
  return ((((longitude + 180) % 360) + 360) % 360) - 180;
}
