// Types of what the page's server answers, for `make check-javascript`. The module `openapi` is made by
// openapi-typescript from `docs/openapi.py`.

declare module "answers" {
  import type { paths } from "openapi";

  /** A path as it is called: each `{name}` filled in, and what is below `/api/v1/` without it. */
  type Filled<P> = P extends `${infer Before}{${string}}${infer After}` ? `${Before}${string}${Filled<After>}` : P;
  type Called<P> = P extends `/api/v1/${infer Below}` ? Filled<Below> : Filled<P>;
  type Path<P> = P extends `${infer Before}?${string}` ? Before : P;

  /** An object that is not described further may hold anything. */
  type Loose<A> = unknown extends A ? any
    : Record<string, unknown> extends A ? any
    : A extends object ? { [K in keyof A]: Loose<A[K]> }
    : A;
  type Json<O> = O extends { responses: { 200: { content: { "application/json": infer A } } } } ? Loose<A> : any;

  /** What a path answers: `never` where there is no such path, `any` where only the running page knows which it is. */
  export type Answer<Method extends string, P extends string> = string extends P ? any : {
    [K in keyof paths]: Path<P> extends Called<K> ? (paths[K] extends Record<Method, infer O> ? Json<O> : never) : never;
  }[keyof paths];
}
